//! Files as bytes and lines.

use std::{borrow::Cow, path::Path};

use unopose_core::files;

/// Largest mesh, material library or texture, bytes.
const LIMIT: u64 = 4 << 30;

/// The content of a regular file; the reason when it cannot be had.
pub(super) fn read_regular(path: &Path) -> Result<Vec<u8>, String> {
    files::read_regular(path, LIMIT).map_err(|e| e.to_string())
}

/// A line as UTF-8, otherwise as Latin-1: names in old files stay different from each other.
pub(super) fn decode(line: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(line) {
        Ok(text) => text.into(),
        Err(_) => line.iter().map(|&b| char::from(b)).collect::<String>().into(),
    }
}

/// A text of the input in a message: its beginning, in quotation marks.
pub(super) fn excerpt(text: &str) -> String {
    const LONGEST: usize = 60;
    let start: String = text.trim_end().chars().take(LONGEST).collect();
    if start.len() < text.trim_end().len() { format!("{start:?}...") } else { format!("{start:?}") }
}
