//! A shard by itself, with what is wrong with it: for looking into a set instead of training on it.

use std::path::{Path, PathBuf};

use super::{
    super::{AnnotatedFrame, FormatError},
    archive::Archive,
    dataset::shard_paths,
    records::ImageRecords,
    shard_image::ShardImage,
};

/// One shard, packed or unpacked.
#[derive(Debug)]
pub struct ShardFile {
    /// Number of the shard, that in its name.
    pub number: u32,
    archive: Archive,
}

impl ShardFile {
    /// Folder with the shards (`dir` or `dir/train_pbr_web`) and all shards in it by number; empty when there are none.
    pub fn list(dir: &Path) -> (PathBuf, Vec<(u32, PathBuf)>) {
        let folders = ["train_pbr_web", "."].map(|sub| dir.join(sub));
        let found = folders.into_iter().map(|f| (shard_paths(&f), f)).find(|(shards, _)| !shards.is_empty());
        found.map_or((dir.to_owned(), Vec::new()), |(shards, folder)| (folder, shards))
    }

    /// Lists the members without reading their content.
    pub fn open(number: u32, path: &Path) -> Result<Self, FormatError> {
        Ok(Self { number, archive: Archive::scan(path)? })
    }

    /// Keys of the images that have all members, sorted.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.archive.images.keys().map(String::as_str)
    }

    /// Damage and missing members.
    pub fn problems(&self) -> &[String] {
        &self.archive.problems
    }

    /// An image with its JSON members as they are.
    pub fn read(&self, key: &str) -> Result<(AnnotatedFrame, ImageRecords), FormatError> {
        let image = ShardImage::read(&self.archive, key)?;
        let records = image.records.clone();
        Ok((image.annotated()?, records))
    }
}
