//! Index files: which instances are worth training on, and where references of an object are.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{
    super::{
        FormatError,
        files::{read_json, write_json},
    },
    dataset::{InstanceRef, ShardDataset},
};

/// An index lists instances with at least this visible share ...
pub const VALID_VISIB_FRACT: f32 = 0.1;
/// ... and this many visible pixels of an image of 640 x 480; of other images the same share of the area.
pub const VALID_PX_COUNT_VISIB: u32 = 512;
/// Smallest visible share of a reference.
pub const REFERENCE_VISIB_FRACT: f32 = 0.8;

const VALID_SUFFIX: &str = "_fixed_valid_inst_ids.json";
const REFERENCES_SUFFIX: &str = "_fixed_obj_id_to_visib0_8_scene_im_inst_ids.json";

/// Shard, key and instance of a reference as the index file lists them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceEntry(pub ShardName, pub String, pub u32);

/// A shard as index files write it: a number or a name that ends in one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ShardName {
    Number(u32),
    Name(String),
}

/// Index files found beside the shards.
#[derive(Debug, Default)]
pub(super) struct Published {
    /// By image key.
    pub valid: Option<HashMap<String, HashSet<u32>>>,
    /// (key, instance) pairs.
    pub references: Option<HashSet<(String, u32)>>,
}

impl Published {
    /// Reads whatever index files lie in the folders.
    pub fn read(folders: &[&Path]) -> Result<Self, FormatError> {
        let find = |suffix: &str| -> Vec<PathBuf> {
            let entries = folders.iter().filter_map(|f| std::fs::read_dir(f).ok()).flatten();
            let files = entries.filter_map(|e| Some(e.ok()?.path()));
            files.filter(|p| p.to_str().is_some_and(|name| name.ends_with(suffix))).collect()
        };
        let mut published = Self::default();
        for file in find(VALID_SUFFIX) {
            let list: HashMap<String, HashSet<u32>> = read_json(&file)?;
            let valid = published.valid.get_or_insert_default();
            // "shard/KEY"; keys are unique within a set.
            valid.extend(list.into_iter().map(|(k, v)| (k.rsplit('/').next().unwrap_or(&k).to_owned(), v)));
        }
        for file in find(REFERENCES_SUFFIX) {
            let list: HashMap<String, Vec<ReferenceEntry>> = read_json(&file)?;
            let references = published.references.get_or_insert_default();
            references.extend(list.into_values().flatten().map(|r| (r.1, r.2)));
        }
        Ok(published)
    }

    pub fn is_valid(&self, key: &str, instance: &InstanceRef) -> bool {
        match &self.valid {
            Some(valid) => valid.get(key).is_some_and(|ids| ids.contains(&instance.instance)),
            // What is large enough is for the configuration to say.
            None => instance.px_count_visib > 0,
        }
    }

    pub fn is_reference(&self, key: &str, instance: &InstanceRef) -> bool {
        match &self.references {
            Some(references) => references.contains(&(key.to_owned(), instance.instance)),
            None => instance.visib_fract >= REFERENCE_VISIB_FRACT,
        }
    }
}

/// Fewest visible pixels of an instance that an index of images of this size lists.
pub fn valid_px_count_visib(width: u32, height: u32) -> u32 {
    let pixels = u64::from(width) * u64::from(height);
    (u64::from(VALID_PX_COUNT_VISIB) * pixels).div_ceil(640 * 480) as u32
}

/// Writes `key_to_shard.json` beside the shards and the two index files into `root`, named after `set`: of `dataset`'s
/// instances those that are large enough for images of `width` x `height`.
pub fn write_index_files(
    root: &Path,
    set: &str,
    dataset: &ShardDataset,
    [width, height]: [u32; 2],
) -> Result<(), FormatError> {
    let least = valid_px_count_visib(width, height);
    let keys: BTreeMap<&str, u32> = dataset.keys_and_shards().collect();
    write_json(&dataset.folder().join("key_to_shard.json"), &keys, false)?;
    let shard_name = |key: &str| format!("{:06}", keys.get(key).copied().unwrap_or_default());
    let mut valid: BTreeMap<String, Vec<u32>> = BTreeMap::new();
    let mut references: BTreeMap<u32, Vec<ReferenceEntry>> = BTreeMap::new();
    let listed = |i: &&InstanceRef| i.visib_fract >= VALID_VISIB_FRACT && i.px_count_visib >= least;
    for instance in dataset.instances().iter().filter(listed) {
        let key = &dataset.image_keys()[instance.image as usize];
        valid.entry(format!("{}/{key}", shard_name(key))).or_default().push(instance.instance);
        if instance.visib_fract >= REFERENCE_VISIB_FRACT {
            let entry = ReferenceEntry(ShardName::Name(shard_name(key)), key.clone(), instance.instance);
            references.entry(instance.obj_id).or_default().push(entry);
        }
    }
    write_json(&root.join(format!("megapose_{set}{VALID_SUFFIX}")), &valid, false)?;
    write_json(&root.join(format!("megapose_{set}{REFERENCES_SUFFIX}")), &references, false)
}
