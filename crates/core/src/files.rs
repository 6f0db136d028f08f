//! Files: complete or absent whatever ends the process or the machine, read only where they have an end.

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

/// Start of the names of files and folders that are being written. A killed process leaves them; nothing reads them.
pub const PART_PREFIX: &str = ".part-";

/// Writes `path` through a temporary file in the same folder that is renamed when `write` succeeded and the content is
/// on the disk, so that no reader ever sees half a file and neither a killed process nor a power failure leaves one.
/// Missing folders are made.
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
    builder.prefix(PART_PREFIX);
    // Temporary files are private by default; the result is to be as readable as any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder).map_err(with_path)?;
    let mut writer = BufWriter::new(file.as_file_mut());
    write(&mut writer).and_then(|()| writer.flush()).map_err(with_path)?;
    drop(writer);
    file.as_file().sync_all().map_err(with_path)?;
    file.persist(path).map_err(|e| with_path(e.error))?;
    sync_folder(folder).map_err(with_path)
}

/// Waits until the names in a folder (renamed, new or removed) are on the disk.
pub fn sync_folder(folder: &Path) -> std::io::Result<()> {
    // Elsewhere a folder cannot be opened as a file.
    #[cfg(unix)]
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // Some file systems know no such thing, and a folder that may be written need not be readable.
        Err(e)
            if !matches!(
                e.kind(),
                ErrorKind::InvalidInput | ErrorKind::Unsupported | ErrorKind::PermissionDenied
            ) =>
        {
            return Err(e);
        }
        _ => {}
    }
    #[cfg(not(unix))]
    let _ = folder;
    Ok(())
}

/// What killed processes left half written in a folder (not below it), sorted; nothing where there is no folder.
pub fn part_files(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let with_path = |source| FileError { path: folder.to_owned(), source };
    let entries = match std::fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(with_path)?,
    };
    let mut parts = Vec::new();
    for entry in entries {
        let entry = entry.map_err(with_path)?;
        if entry.file_name().to_string_lossy().starts_with(PART_PREFIX) {
            parts.push(entry.path());
        }
    }
    parts.sort();
    Ok(parts)
}

/// Removes [`part_files`]. Only for a folder that nobody else writes into.
pub fn remove_part_files(folder: &Path) -> Result<(), FileError> {
    for path in part_files(folder)? {
        let removed =
            if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        removed.map_err(|source| FileError { path, source })?;
    }
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

    #[test]
    fn only_what_is_half_written_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in [".part-abc", "part-of-it.txt", ".hidden"] {
            std::fs::write(path(name), "x").unwrap();
        }
        std::fs::create_dir_all(path(".part-state-3/inner")).unwrap();
        assert_eq!(part_files(folder.path()).unwrap(), [path(".part-abc"), path(".part-state-3")]);
        remove_part_files(folder.path()).unwrap();
        assert!(part_files(folder.path()).unwrap().is_empty());
        assert!(path("part-of-it.txt").exists() && path(".hidden").exists());
        assert!(part_files(&path("absent")).unwrap().is_empty());
    }
}
