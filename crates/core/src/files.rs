//! Files: written whole or not at all, read only where they have an end.

use std::{
    fs::File,
    io::{BufWriter, Error, ErrorKind, Read, Write},
    path::{Path, PathBuf},
};

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}")]
pub struct FileError {
    /// The file, not the temporary one beside it.
    pub path: PathBuf,
    /// What the system says.
    pub source: std::io::Error,
}

/// Writes `path` through a temporary file in the same folder that is renamed when `write` succeeded, so that
/// no reader ever sees half a file and no killed process leaves one. Missing folders are made.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> std::io::Result<()>,
) -> Result<(), FileError> {
    let with_path = |source| FileError { path: path.to_path_buf(), source };
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

/// Opens a file for reading. What may block or never end (a pipe, a socket, a device) and a folder are errors: readers take
/// paths of files alone.
pub fn open_regular(path: &Path) -> std::io::Result<File> {
    // Opening a pipe already waits for its writer, so the kind is looked up first; links are followed.
    let kind = std::fs::metadata(path)?.file_type();
    if !kind.is_file() {
        let kind = if kind.is_dir() { "a folder" } else { "a pipe, socket or device" };
        return Err(Error::new(ErrorKind::InvalidInput, format!("this is {kind}, expected a regular file")));
    }
    File::open(path)
}

/// The content of a regular file of at most `limit` bytes.
pub fn read_regular(path: &Path, limit: u64) -> std::io::Result<Vec<u8>> {
    let file = open_regular(path)?;
    let too_large = |length: u64| {
        Error::new(ErrorKind::FileTooLarge, format!("{length} bytes, expected at most {limit}"))
    };
    let length = file.metadata()?.len();
    if length > limit {
        return Err(too_large(length));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
    // The file may grow meanwhile, and files of /proc have length 0.
    match file.take(limit.saturating_add(1)).read_to_end(&mut bytes)? as u64 {
        read if read > limit => Err(too_large(read)),
        _ => Ok(bytes),
    }
}

/// [`read_regular`] as UTF-8 text.
pub fn read_text(path: &Path, limit: u64) -> std::io::Result<String> {
    let bytes = read_regular(path, limit)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(ErrorKind::InvalidData, format!("not UTF-8 text: byte {at} is no part of a character"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_within_the_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, [b'a', b'b', 0xff]).unwrap();
        assert_eq!(read_regular(&path, 3).unwrap(), [b'a', b'b', 0xff]);
        let message = read_regular(&path, 2).unwrap_err().to_string();
        assert_eq!(message, "3 bytes, expected at most 2");
        assert!(read_text(&path, 3).unwrap_err().to_string().contains("byte 2"));
        let message = read_regular(folder.path(), 3).unwrap_err().to_string();
        assert!(message.contains("a folder, expected a regular file"), "{message}");
        assert_eq!(read_regular(&folder.path().join("b"), 3).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for path in [Path::new("/dev/zero"), &socket] {
            let message = open_regular(path).unwrap_err().to_string();
            assert!(message.contains("device, expected a regular file"), "{message}");
        }
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert_eq!(read_regular(&link, u64::MAX).unwrap_err().kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/folder/a.json");
        write_atomic(&path, |writer| writer.write_all(b"whole")).unwrap();
        let failed = write_atomic(&path, |writer| {
            writer.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("a.json: disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }
}
