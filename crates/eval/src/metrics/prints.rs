//! Targets whose pose only the print decides, where a dataset says which.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde::{Deserialize, Serialize};
use unopose_dataset::formats::{BopDataset, FormatError, files::read_json};

use super::{
    PoseAccuracy,
    outcome::TargetOutcome,
    scores::{AverageRecall, average_recall},
};

/// The list, beside the dataset's models, or in the folder of a training set's models.
const FILE: &str = "print_decides.json";

/// Scores of the targets of one kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PrintScore {
    /// Average recalls, which forgive much on small objects.
    #[serde(flatten)]
    pub recall: AverageRecall,
    /// Share of the targets with a rotation error below 15 degrees: whether the print was read.
    #[serde(rename = "Acc15")]
    pub acc15: f64,
}

/// One entry of the list.
#[derive(Deserialize)]
struct Entry {
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    /// What the shape leaves open: `axis` (a turn about it), `flip` (half turns), `none`.
    kind: String,
}

/// An object of a set of training shards whose pose only its print tells.
#[derive(Deserialize)]
struct ObjectEntry {
    obj_id: u32,
}

/// The objects of a set of training shards whose pose only their print tells, from the list in its folder `models`; none for a
/// set without the list.
pub fn print_decided_objects(models: &Path) -> Result<BTreeSet<u32>, FormatError> {
    let path = models.join(FILE);
    if !path.is_file() {
        return Ok(BTreeSet::new());
    }
    let entries: Vec<ObjectEntry> = read_json(&path)?;
    Ok(entries.into_iter().map(|entry| entry.obj_id).collect())
}

/// Scores by kind; empty for a dataset without the list.
pub(super) fn per_print(
    dataset: &BopDataset,
    targets: &[TargetOutcome],
) -> Result<BTreeMap<String, PrintScore>, FormatError> {
    let path = dataset.file(FILE);
    if !path.is_file() {
        return Ok(BTreeMap::new());
    }
    let entries: Vec<Entry> = read_json(&path)?;
    let kinds: BTreeMap<[u32; 3], String> =
        entries.into_iter().map(|e| ([e.scene_id, e.im_id, e.obj_id], e.kind)).collect();
    let mut groups: BTreeMap<String, Vec<TargetOutcome>> = BTreeMap::new();
    for target in targets {
        if let Some(kind) = kinds.get(&[target.scene_id, target.im_id, target.obj_id]) {
            groups.entry(kind.clone()).or_default().push(target.clone());
        }
    }
    let score = |group: Vec<TargetOutcome>| PrintScore {
        recall: average_recall(&group),
        acc15: PoseAccuracy::of(&group).acc15,
    };
    Ok(groups.into_iter().map(|(kind, group)| (kind, score(group))).collect())
}
