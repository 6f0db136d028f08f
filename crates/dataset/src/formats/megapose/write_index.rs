//! Writing the index files of a set.

use std::{collections::BTreeMap, path::Path};

use super::{
    super::{FormatError, files::write_json},
    dataset::ShardDataset,
    index_files::{REFERENCE_VISIB_FRACT, REFERENCES_SUFFIX, ReferenceEntry, ShardName, VALID_SUFFIX},
    instance::InstanceRef,
};

/// An index lists instances with at least this visible share ...
const VALID_VISIB_FRACT: f32 = 0.1;
/// ... and this many visible pixels of an image of 640 x 480; of other images the same share of the area.
const VALID_PX_COUNT_VISIB: u32 = 512;

/// Fewest visible pixels of an instance that an index of images of this size lists.
fn valid_px_count_visib(width: u32, height: u32) -> u32 {
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
