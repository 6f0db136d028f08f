//! Lengths and checksums of the files of a state folder, so that damage is found before anything is made of it.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use unopose_core::files::write_atomic;

use crate::TrainError;

const MANIFEST_FILE: &str = "manifest.json";

/// The files of a folder by name.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Manifest(BTreeMap<String, Stamp>);

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Stamp {
    bytes: usize,
    crc32: u32,
}

impl Manifest {
    /// Stamps files of the folder and writes the manifest beside them.
    pub fn write(folder: &Path, files: &[&str]) -> Result<Self, TrainError> {
        let mut manifest = Self::default();
        for file in files {
            let content = read(&folder.join(file))?;
            manifest.0.insert((*file).to_owned(), Stamp::of(&content));
        }
        write_atomic(&folder.join(MANIFEST_FILE), |writer| Ok(serde_json::to_writer(writer, &manifest)?))?;
        Ok(manifest)
    }

    /// The manifest of a folder.
    pub fn read(folder: &Path) -> Result<Self, TrainError> {
        let path = folder.join(MANIFEST_FILE);
        serde_json::from_slice(&read(&path)?).map_err(|e| damaged(path, &e.to_string()))
    }

    /// Whether the folder has a file of this name.
    pub fn lists(&self, file: &str) -> bool {
        self.0.contains_key(file)
    }

    /// Content of a file, as it was written.
    pub fn verified(&self, folder: &Path, file: &str) -> Result<Vec<u8>, TrainError> {
        let path = folder.join(file);
        let Some(expected) = self.0.get(file) else {
            return Err(damaged(folder.join(MANIFEST_FILE), &format!("does not list {file}")));
        };
        let content = read(&path)?;
        let found = Stamp::of(&content);
        if found == *expected {
            return Ok(content);
        }
        let what = format!(
            "damaged: {} bytes with CRC-32 {:08x}, written were {} with {:08x}",
            found.bytes, found.crc32, expected.bytes, expected.crc32
        );
        Err(damaged(path, &what))
    }
}

impl Stamp {
    fn of(content: &[u8]) -> Self {
        Self { bytes: content.len(), crc32: crc32fast::hash(content) }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, TrainError> {
    fs::read(path).map_err(|e| damaged(path.to_owned(), &e.to_string()))
}

/// An error about a file of a state folder, with the way out.
pub fn damaged(path: PathBuf, what: &str) -> TrainError {
    let message = format!("{what}; --reset-optimizer goes on from the weights of last.safetensors alone");
    TrainError::State { path, message }
}
