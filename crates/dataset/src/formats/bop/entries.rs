//! The JSON files of a scene: an object with an entry per image.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::super::{
    FormatError,
    files::{json_from_value, quoted_nan, read_bytes},
    numbered::ById,
};

/// The entries of a file by image. A broken one is an error when its image is asked for, and not before.
#[derive(Debug)]
pub(super) struct Entries<T> {
    path: PathBuf,
    entries: BTreeMap<u32, Entry<T>>,
}

#[derive(Debug)]
enum Entry<T> {
    Read(T),
    Broken(Value),
}

impl<T: DeserializeOwned> Entries<T> {
    /// Reads a file. Syntax errors, keys that are no number, and an image that is there twice concern the whole file.
    pub(super) fn read(path: &Path) -> Result<Self, FormatError> {
        let bytes = read_bytes(path)?;
        let path = path.to_path_buf();
        // Nearly always everything is right.
        if let Ok(ById(entries)) = serde_json::from_slice::<ById<T>>(&bytes) {
            let entries = entries.into_iter().map(|(id, entry)| (id, Entry::Read(entry))).collect();
            return Ok(Self { path, entries });
        }
        let values = serde_json::from_slice::<ById<Value>>(&quoted_nan(&bytes));
        let ById(values) = values.map_err(|source| FormatError::Json { path: path.clone(), source })?;
        let entry = |value: Value| match T::deserialize(&value) {
            Ok(entry) => Entry::Read(entry),
            Err(_) => Entry::Broken(value),
        };
        Ok(Self { entries: values.into_iter().map(|(id, value)| (id, entry(value))).collect(), path })
    }

    /// Of a file that is not there.
    pub(super) fn absent(path: PathBuf) -> Self {
        Self { path, entries: BTreeMap::new() }
    }

    /// File of the entries.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Images with an entry, also with a broken one; sorted.
    pub(super) fn image_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.entries.keys().copied()
    }

    /// Has the file an entry of this image?
    pub(super) fn contains(&self, im_id: u32) -> bool {
        self.entries.contains_key(&im_id)
    }

    /// Entries that could be read.
    pub(super) fn readable(&self) -> impl Iterator<Item = &T> {
        self.entries.values().filter_map(|entry| match entry {
            Entry::Read(entry) => Some(entry),
            Entry::Broken(_) => None,
        })
    }

    /// The entry of an image; the error says what is wrong with it.
    pub(super) fn get(&self, im_id: u32) -> Result<&T, FormatError> {
        match self.entries.get(&im_id) {
            Some(Entry::Read(entry)) => Ok(entry),
            Some(Entry::Broken(value)) => {
                let place = self.place(im_id);
                Err(json_from_value::<T>(value, &place).err().unwrap_or_else(|| {
                    FormatError::field(&place, "entry", "unreadable", "one like those of other images")
                }))
            }
            None => {
                let hint = if self.entries.is_empty() { "the file is absent or empty" } else { "" };
                Err(FormatError::missing(self.path.display(), format!("image {im_id}"), hint))
            }
        }
    }

    /// File and image, for messages.
    pub(super) fn place(&self, im_id: u32) -> String {
        format!("{}: image {im_id}", self.path.display())
    }
}
