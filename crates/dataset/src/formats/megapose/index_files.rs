//! The index files beside the shards: which instances are worth training on, and where references of an object are.

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::{
    super::{FormatError, files::read_json},
    instance::InstanceRef,
};

/// Smallest visible share of a reference.
pub(super) const REFERENCE_VISIB_FRACT: f32 = 0.8;

pub(super) const VALID_SUFFIX: &str = "_fixed_valid_inst_ids.json";
pub(super) const REFERENCES_SUFFIX: &str = "_fixed_obj_id_to_visib0_8_scene_im_inst_ids.json";

/// Shard, image key and instance number of a reference as the index file lists them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceEntry(pub(super) ShardName, pub String, pub u32);

/// A shard as index files write it: a number or a name that ends in one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(super) enum ShardName {
    Number(u32),
    Name(String),
}

/// Index files found beside the shards.
#[derive(Debug, Default)]
pub(super) struct IndexFiles {
    /// By image key.
    pub valid: Option<HashMap<String, HashSet<u32>>>,
    /// (key, instance) pairs.
    pub references: Option<HashSet<(String, u32)>>,
}

impl IndexFiles {
    /// Reads whatever index files lie in the folders.
    pub fn read(folders: &[&Path]) -> Result<Self, FormatError> {
        let find = |suffix: &str| -> Vec<PathBuf> {
            let entries = folders.iter().filter_map(|f| std::fs::read_dir(f).ok()).flatten();
            let files = entries.filter_map(|e| Some(e.ok()?.path()));
            files.filter(|p| p.to_str().is_some_and(|name| name.ends_with(suffix))).collect()
        };
        let mut found = Self::default();
        for file in find(VALID_SUFFIX) {
            let list: HashMap<String, HashSet<u32>> = read_json(&file)?;
            let valid = found.valid.get_or_insert_default();
            // "shard/KEY"; keys are unique within a set.
            valid.extend(list.into_iter().map(|(k, v)| (k.rsplit('/').next().unwrap_or(&k).to_owned(), v)));
        }
        for file in find(REFERENCES_SUFFIX) {
            let list: HashMap<String, Vec<ReferenceEntry>> = read_json(&file)?;
            let references = found.references.get_or_insert_default();
            references.extend(list.into_values().flatten().map(|r| (r.1, r.2)));
        }
        Ok(found)
    }

    /// Says how many of the listed images are in no shard.
    pub fn dangling(&self, keys: &HashSet<String>) -> Option<String> {
        let references = self.references.iter().flatten().map(|(key, _)| key);
        let listed: HashSet<&String> = self.valid.iter().flat_map(HashMap::keys).chain(references).collect();
        let dangling = listed.iter().filter(|key| !keys.contains(**key)).count();
        let total = listed.len();
        (dangling > 0)
            .then(|| format!("{dangling} of the {total} images in the index files are in no usable shard"))
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
