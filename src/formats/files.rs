//! Whole-file reading and writing: JSON in, anything out through a temporary file.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
};

use serde::{Serialize, de::DeserializeOwned};

use super::FormatError;

/// What [`write_atomic`] hands to its closure.
pub type AtomicWriter<'a> = BufWriter<&'a mut File>;

/// Writes `path` through a temporary file in the same folder that is renamed when `write` succeeded, so that
/// no reader and no killed process ever sees half a file. Missing folders are made.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut AtomicWriter) -> std::io::Result<()>,
) -> Result<(), FormatError> {
    let with_path = |e| FormatError::io(path, e);
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(with_path)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".part-");
    // Temporary files are private by default; the result is to be as readable as any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder).map_err(with_path)?;
    let mut writer = BufWriter::new(file.as_file_mut());
    write(&mut writer).and_then(|()| writer.flush()).map_err(with_path)?;
    drop(writer);
    file.persist(path).map_err(|e| with_path(e.error))?;
    Ok(())
}

/// Parses a JSON file; the error names the file, line and column.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, FormatError> {
    let bytes = std::fs::read(path).map_err(|e| FormatError::io(path, e))?;
    serde_json::from_slice(&bytes).map_err(|source| FormatError::Json { path: path.to_path_buf(), source })
}

/// Writes a JSON file atomically, indented when `pretty`.
pub fn write_json<T: Serialize + ?Sized>(path: &Path, value: &T, pretty: bool) -> Result<(), FormatError> {
    write_atomic(path, |writer| {
        if pretty {
            serde_json::to_writer_pretty(&mut *writer, value)?;
        } else {
            serde_json::to_writer(&mut *writer, value)?;
        }
        writer.write_all(b"\n")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/folder/a.json");
        write_json(&path, &[1, 2], false).unwrap();
        let failed = write_atomic(&path, |writer| {
            writer.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("a.json: disk full"));
        assert_eq!(read_json::<Vec<u32>>(&path).unwrap(), [1, 2]);
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_broken_json_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("b.json");
        std::fs::write(&path, "[1,\nNaN]").unwrap();
        let message = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
        assert!(message.contains("b.json") && message.contains("line 2"), "{message}");
    }
}
