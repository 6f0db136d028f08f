//! JSON files, whole.

use std::{borrow::Cow, fmt::Display, io::Write, path::Path};

use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use unopose_core::files::{read_regular, write_atomic};

use super::FormatError;

/// Bytes of the largest JSON file.
const MAX_JSON: u64 = 4 << 30;

/// Parses a JSON file; the error names the file, the field, line and column.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, FormatError> {
    let bytes = read_bytes(path)?;
    serde_json::from_slice(&bytes).map_err(|source| {
        let quoted = quoted_nan(&bytes);
        let again =
            serde_path_to_error::deserialize::<_, T>(&mut serde_json::Deserializer::from_slice(&quoted));
        match again {
            Err(error) => json_error(error, path.display()),
            Ok(_) => FormatError::Json { path: path.to_path_buf(), source },
        }
    })
}

/// The bytes of a file.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, FormatError> {
    read_regular(path, MAX_JSON).map_err(|e| FormatError::io(path, e))
}

/// A value of a JSON file as `T`; `place` and the field stand in the message.
pub(super) fn json_from_value<T: DeserializeOwned>(value: &Value, place: &str) -> Result<T, FormatError> {
    serde_path_to_error::deserialize(value).map_err(|error| json_error(error, place))
}

fn json_error(error: serde_path_to_error::Error<serde_json::Error>, place: impl Display) -> FormatError {
    // A text that ends too early has no field.
    let path = match error.path().to_string().as_str() {
        "." | "?" => place.to_string(),
        field => format!("{place}: {field}"),
    };
    FormatError::Json { path: path.into(), source: error.into_inner() }
}

/// `NaN` and `Infinity`, which Python writes and JSON does not know, as strings: so the message about them can name the
/// field.
pub(super) fn quoted_nan(bytes: &[u8]) -> Cow<'_, [u8]> {
    let (mut quoted, mut copied, mut at, mut in_string) = (Vec::new(), 0, 0, false);
    while let Some(&byte) = bytes.get(at) {
        let word =
            [&b"NaN"[..], b"-Infinity", b"Infinity"].into_iter().find(|word| bytes[at..].starts_with(word));
        match (byte, word) {
            (b'\\', _) if in_string => at += 1,
            (b'"', _) => in_string = !in_string,
            (_, Some(word)) if !in_string => {
                quoted.extend_from_slice(&bytes[copied..at]);
                quoted.extend([b"\"", word, b"\""].concat());
                copied = at + word.len();
                at = copied - 1;
            }
            _ => {}
        }
        at += 1;
    }
    if copied == 0 {
        return Cow::Borrowed(bytes);
    }
    quoted.extend_from_slice(&bytes[copied..]);
    Cow::Owned(quoted)
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
        assert!(message.contains("b.json: [1]") && message.contains("line 2"), "{message}");
        assert!(message.contains("NaN"), "{message}");
        std::fs::write(&path, "[1,\n2").unwrap();
        let message = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
        assert!(message.contains("b.json") && message.contains("line 2"), "{message}");
    }

    #[test]
    fn words_inside_strings_stay() {
        let text = br#"{"NaN \" NaN": [-Infinity, "\\", NaN]}"#;
        let expected = br#"{"NaN \" NaN": ["-Infinity", "\\", "NaN"]}"#;
        assert_eq!(quoted_nan(text).as_ref(), expected);
        assert!(matches!(quoted_nan(b"[\"NaN\"]"), Cow::Borrowed(_)));
    }
}
