//! What is known of a list besides its targets.

use std::collections::BTreeMap;

use serde::Serialize;
use unopose_dataset::{
    formats::ReferenceTarget,
    protocol::{SkippedDetection, TargetList},
};
use unopose_eval::metrics::ROTATION_EDGES;

use super::UnoSegMasks;

/// How a list came about.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ListFacts {
    /// Name of the protocol or of the file.
    pub list: String,
    /// Where the masks come from.
    pub segmentation: String,
    /// Targets that the protocol finds no reference for; they are not in the list.
    pub without_reference: usize,
    /// Seed of the choice of references; `None` for a list that was read.
    pub list_seed: Option<u64>,
    /// COCO's mAP of given masks.
    pub mask_map: Option<f64>,
    /// Masks that UNOSeg found, by the sources of proposals that were tried.
    #[serde(rename = "own_masks")]
    pub unoseg_masks: Vec<UnoSegMasks>,
}

/// Targets whose reference is between two angles away.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct OverlapBin {
    pub from: f64,
    pub to: f64,
    pub targets: usize,
    /// Mean and standard deviation of the overlap ratio, where the list has it.
    pub overlap: Option<[f64; 2]>,
}

/// Overlap ratios by angle, of the entries that say both; bins without entries are left out.
pub(crate) fn overlap_bins(targets: &[ReferenceTarget]) -> Vec<OverlapBin> {
    let bin = |limits: &[f64]| {
        let (from, to) = (limits[0], limits[1]);
        let inside = targets.iter().filter(|t| t.rot_deg.is_some_and(|d| d >= from && d < to));
        let overlaps: Vec<f64> = inside.clone().filter_map(|t| t.overlap).collect();
        let count = overlaps.len() as f64;
        let mean = overlaps.iter().sum::<f64>() / count;
        let variance = overlaps.iter().map(|o| (o - mean).powi(2)).sum::<f64>() / count;
        let overlap = (!overlaps.is_empty()).then_some([mean, variance.sqrt()]);
        OverlapBin { from, to, targets: inside.count(), overlap }
    };
    ROTATION_EDGES.windows(2).map(bin).filter(|bin| bin.targets > 0).collect()
}

/// Detections skipped for bad input, counted by reason with the first entry of each.
pub(crate) fn skipped_by_reason(list: &TargetList) -> Vec<(String, usize)> {
    let mut reasons: BTreeMap<&str, (usize, &SkippedDetection)> = BTreeMap::new();
    for skipped in &list.skipped {
        reasons.entry(&skipped.reason).or_insert((0, skipped)).0 += 1;
    }
    let line = |(reason, (count, first)): (&str, (usize, &SkippedDetection))| {
        let SkippedDetection { scene_id, im_id, obj_id, entry, .. } = first;
        (format!("{reason} (first: entry {entry}, scene {scene_id} image {im_id} object {obj_id})"), count)
    };
    reasons.into_iter().map(line).collect()
}
