//! Index files of shards and target lists of scenes against the images that are there.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use unopose_dataset::formats::{
    BopSplit, FormatError,
    files::read_json,
    megapose::ReferenceEntry,
    targets::{read_reference_targets, read_targets},
};

use super::report::Finding;

/// What is known of an image of a shard.
pub(super) struct KnownImage {
    pub shard: u32,
    /// `None` for an image that was not decoded.
    pub instances: Option<usize>,
}

/// Files of a folder whose names end in `suffix`, sorted.
fn files_ending(folder: &Path, suffix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).ok().into_iter().flatten().filter_map(|e| Some(e.ok()?.path()));
    let mut files: Vec<PathBuf> =
        entries.filter(|p| p.to_str().is_some_and(|name| name.ends_with(suffix))).collect();
    files.sort();
    files
}

/// Entries of a list that refer to nothing.
#[derive(Default)]
struct Dangling(Vec<String>);

impl Dangling {
    fn finding(self, file: &Path, what: &str) -> Option<Finding> {
        let examples = self.0.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
        (!self.0.is_empty())
            .then(|| Finding::new(file.display(), format!("{} {what}: {examples} ...", self.0.len())))
    }
}

/// `key_to_shard.json` and the two published index files; `generated` sets have to have them.
pub(super) fn check_index_files(
    root: &Path,
    folder: &Path,
    known: &HashMap<String, KnownImage>,
    generated: bool,
) -> Result<Vec<Finding>, FormatError> {
    let mut findings = Vec::new();
    let keys_file = folder.join("key_to_shard.json");
    if keys_file.is_file() {
        let (mut dangling, list) = (Dangling::default(), read_json::<BTreeMap<String, u32>>(&keys_file)?);
        for (key, shard) in &list {
            if known.get(key).is_none_or(|k| k.shard != *shard) {
                dangling.0.push(format!("{key} in shard {shard}"));
            }
        }
        dangling
            .0
            .extend(known.keys().filter(|k| !list.contains_key(*k)).map(|k| format!("{k} is not listed")));
        dangling.0.sort();
        findings.extend(dangling.finding(&keys_file, "entries do not agree with the shards"));
    }
    // "shard/KEY"
    let split = |name: &str| name.rsplit('/').next().unwrap_or(name).to_owned();
    let bad = |key: &str, instance: u32| match known.get(key) {
        None => true,
        Some(image) => image.instances.is_some_and(|n| instance as usize >= n),
    };
    let valid_files = files_ending(root, "_valid_inst_ids.json");
    for file in &valid_files {
        let list: BTreeMap<String, Vec<u32>> = read_json(file)?;
        let all = list.iter().flat_map(|(name, ids)| ids.iter().map(|id| (split(name), *id)));
        let dangling = all.filter(|(key, id)| bad(key, *id)).map(|(key, id)| format!("{key} instance {id}"));
        findings.extend(Dangling(dangling.collect()).finding(file, "instances are not in the shards"));
    }
    for file in files_ending(root, "_visib0_8_scene_im_inst_ids.json") {
        let list: BTreeMap<String, Vec<ReferenceEntry>> = read_json(&file)?;
        let dangling = list.values().flatten().filter(|r| bad(&r.1, r.2));
        let dangling = Dangling(dangling.map(|r| format!("{} instance {}", r.1, r.2)).collect());
        findings.extend(dangling.finding(&file, "references are not in the shards"));
    }
    if generated && valid_files.is_empty() {
        findings.push(Finding::new(
            root.display(),
            "index files are missing: the set is unfinished; the command that made it continues it",
        ));
    }
    Ok(findings)
}

/// Every `*targets*.json` of a BOP set against the annotation of its splits.
pub(super) fn check_targets(root: &Path, splits: &[BopSplit]) -> Vec<Finding> {
    let count = |scene_id: u32, im_id: u32, obj_id: u32| -> usize {
        let of_split = |split: &BopSplit| -> Option<usize> {
            let scene = split.scene(scene_id).ok()?;
            Some(scene.gt(im_id).ok()?.iter().filter(|g| g.obj_id == obj_id).count())
        };
        splits.iter().filter_map(of_split).max().unwrap_or(0)
    };
    let mut findings = Vec::new();
    let files = files_ending(root, ".json").into_iter();
    for file in files.filter(|f| f.file_name().is_some_and(|n| n.to_string_lossy().contains("targets"))) {
        let mut dangling = Dangling::default();
        match read_targets(&file) {
            Ok(targets) => {
                for t in
                    targets.iter().filter(|t| count(t.scene_id, t.im_id, t.obj_id) < t.inst_count as usize)
                {
                    dangling.0.push(format!("scene {} image {} object {}", t.scene_id, t.im_id, t.obj_id));
                }
            }
            Err(error) => findings.push(Finding::new("targets", error)),
        }
        findings.extend(dangling.finding(&file, "targets are not annotated"));
        let Ok(references) = read_reference_targets(&file) else { continue };
        let absent = references.iter().filter(|r| count(r.ref_scene_id, r.ref_im_id, r.obj_id) == 0);
        let dangling =
            absent.map(|r| format!("scene {} image {} object {}", r.ref_scene_id, r.ref_im_id, r.obj_id));
        findings.extend(Dangling(dangling.collect()).finding(&file, "references are not annotated"));
    }
    findings
}
