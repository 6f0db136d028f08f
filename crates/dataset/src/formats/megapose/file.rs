//! A shard by itself, with what is wrong with it: for looking into a set instead of training on it.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use unopose_core::frame::Mask;

use super::{
    super::{AnnotatedFrame, FormatError, ModelInfo},
    archive::Archive,
    dataset::shard_paths,
    instance_fault::{InstanceFault, invert},
    records::ImageRecords,
    shard_image::{ShardImage, decode_mask},
};

/// An image of a shard with what is wrong with its instances.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ShardFileImage {
    /// The image as training gets it: visible masks are mended or empty where they have a fault.
    pub annotated: AnnotatedFrame,
    /// The JSON members as they are.
    pub records: ImageRecords,
    /// Whole silhouettes, those of inverted visible masks mended like them; empty when the shard has none.
    pub masks: Vec<Mask>,
    /// Faulty instances by number.
    pub faults: Vec<(usize, InstanceFault)>,
}

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

    /// An image with everything that the shard says about it; `models` are the objects whose size is known.
    pub fn read(&self, key: &str, models: &BTreeMap<u32, ModelInfo>) -> Result<ShardFileImage, FormatError> {
        let image = ShardImage::read(&self.archive, key)?;
        let (records, name) = (image.records.clone(), image.name.clone());
        let (annotated, faults) = image.annotated(models)?;
        let decoded = records.mask.iter().enumerate();
        let decoded = decoded
            .map(|(i, m)| decode_mask(m, &annotated.frame, &format!("{name}.mask.json: instance {i}")));
        let mut masks = decoded.collect::<Result<Vec<_>, _>>()?;
        for (i, _) in faults.iter().filter(|(_, fault)| fault.is_mended()) {
            // Whole silhouettes come from the same writer as the visible ones.
            let visible = &annotated.instances[*i].mask_visib;
            if let Some(mask) = masks.get_mut(*i).filter(|m| m.iou(visible) == 0.0) {
                invert(mask);
            }
        }
        Ok(ShardFileImage { annotated, records, masks, faults })
    }
}
