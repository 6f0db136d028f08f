//! One process at a time in a folder that is being filled.
//!
//! The lock is the operating system's on the file `.lock`, so it ends with its process however that ends, and a file that
//! a killed process left is taken over. What stands in it only tells others who holds the lock.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{ErrorKind, Read as _, Write as _},
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use serde::{Deserialize, Serialize};

use crate::files::FileError;

/// Name of the file in a locked folder.
const LOCK_FILE: &str = ".lock";

/// The folder is this process's (or these processes') until the value is dropped.
#[derive(Debug)]
pub struct FolderLock {
    /// `None` where nothing can be locked: a folder that cannot be written, a file system without locks.
    file: Option<File>,
    path: PathBuf,
    exclusive: bool,
}

/// Why a folder cannot be locked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LockError {
    /// Another process works in the folder.
    #[error("{}: in use by {owner}; wait until it has ended or choose another folder", folder.display())]
    Held {
        /// The folder.
        folder: PathBuf,
        /// Process, host and age, as far as the lock file tells.
        owner: String,
    },
    /// The folder or its lock file cannot be made or written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// What the lock file says.
#[derive(Debug, Serialize, Deserialize)]
struct Owner {
    process: u32,
    host: String,
    /// Seconds since 1970.
    since: u64,
}

impl FolderLock {
    /// Makes the folder if it is absent, and locks it against everybody else.
    pub fn exclusive(folder: &Path) -> Result<Self, LockError> {
        Self::acquire(folder, true)
    }

    /// Makes the folder if it is absent, and locks it against [`Self::exclusive`] only.
    pub fn shared(folder: &Path) -> Result<Self, LockError> {
        Self::acquire(folder, false)
    }

    fn acquire(folder: &Path, exclusive: bool) -> Result<Self, LockError> {
        let path = folder.join(LOCK_FILE);
        let with_path = |source| FileError { path: path.clone(), source };
        std::fs::create_dir_all(folder).map_err(|source| FileError { path: folder.to_owned(), source })?;
        let lock = if exclusive { File::try_lock } else { File::try_lock_shared };
        let mut file = loop {
            let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
            let mut file = match opened {
                Ok(file) => file,
                // Nothing can be written there; what needs to be will say so.
                Err(e) if matches!(e.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => {
                    return Ok(Self { file: None, path, exclusive });
                }
                Err(e) => return Err(with_path(e).into()),
            };
            match lock(&file) {
                Ok(()) if is_at(&file, &path) => break file,
                // Its owner has just ended and removed it.
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(LockError::Held { folder: folder.to_owned(), owner: Owner::read(&mut file) });
                }
                // Some network file systems know no locks.
                Err(TryLockError::Error(e)) => {
                    tracing::warn!(
                        "{} cannot be locked ({e}): another process at work there would not be noticed",
                        folder.display()
                    );
                    return Ok(Self { file: None, path, exclusive });
                }
            }
        };
        let owner = serde_json::to_vec(&Owner::this()).map_err(|e| with_path(e.into()))?;
        file.set_len(0).and_then(|()| file.write_all(&owner)).map_err(with_path)?;
        Ok(Self { file: Some(file), path, exclusive })
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // While the lock is held: nobody else can believe to hold the file that goes.
        if self.exclusive && self.file.is_some() && cfg!(unix) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Whether the opened file is still the one of this name.
fn is_at(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let identity = |metadata: std::fs::Metadata| (metadata.dev(), metadata.ino());
        let (opened, named) = (file.metadata().map(identity), std::fs::metadata(path).map(identity));
        matches!((opened, named), (Ok(opened), Ok(named)) if opened == named)
    }
    // Elsewhere the file is never removed.
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

impl Owner {
    fn this() -> Self {
        Self {
            process: std::process::id(),
            host: gethostname::gethostname().to_string_lossy().into_owned(),
            since: seconds(),
        }
    }

    /// A few words from the lock file.
    fn read(file: &mut File) -> String {
        let mut text = String::new();
        let read = file.take(4096).read_to_string(&mut text);
        let Some(owner) = read.ok().and_then(|_| serde_json::from_str::<Self>(&text).ok()) else {
            return "another process".into();
        };
        let minutes = seconds().saturating_sub(owner.since) / 60;
        format!("process {} on {}, since {minutes} min", owner.process, owner.host)
    }
}

fn seconds() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_folder_names_its_owner_and_is_free_again_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        let lock = FolderLock::exclusive(&folder).unwrap();
        let message = FolderLock::exclusive(&folder).unwrap_err().to_string();
        let host = gethostname::gethostname().to_string_lossy().into_owned();
        let owner = format!("new: in use by process {} on {host}, since 0 min", std::process::id());
        assert!(message.contains(&owner), "{message}");
        assert!(FolderLock::shared(&folder).is_err());
        drop(lock);
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
        // What a killed process leaves: the file, longer than what is written next, and no lock.
        std::fs::write(folder.join(LOCK_FILE), "x".repeat(300)).unwrap();
        let shared = [FolderLock::shared(&folder).unwrap(), FolderLock::shared(&folder).unwrap()];
        assert!(FolderLock::exclusive(&folder).unwrap_err().to_string().contains(&owner));
        drop(shared);
        FolderLock::exclusive(&folder).unwrap();
    }
}
