//! JSON files, whole.

use std::{io::Write, path::Path};

use serde::{Serialize, de::DeserializeOwned};
use unopose_core::files::{read_regular, write_atomic};

use super::FormatError;

/// Bytes of the largest JSON file.
const MAX_JSON: u64 = 4 << 30;

/// Parses a JSON file; the error names the file, line and column.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, FormatError> {
    let bytes = read_regular(path, MAX_JSON).map_err(|e| FormatError::io(path, e))?;
    serde_json::from_slice(&bytes).map_err(|source| FormatError::Json { path: path.to_path_buf(), source })
}

/// Writes a JSON file atomically, indented when `pretty`.
pub fn write_json<T: Serialize + ?Sized>(path: &Path, value: &T, pretty: bool) -> Result<(), FormatError> {
    let written = write_atomic(path, |writer| {
        if pretty {
            serde_json::to_writer_pretty(&mut *writer, value)?;
        } else {
            serde_json::to_writer(&mut *writer, value)?;
        }
        writer.write_all(b"\n")
    });
    Ok(written?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_json_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("b.json");
        std::fs::write(&path, "[1,\nNaN]").unwrap();
        let message = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
        assert!(message.contains("b.json") && message.contains("line 2"), "{message}");
    }
}
