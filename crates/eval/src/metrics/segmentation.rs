//! Scores of a segmentation run: what the proposals cover, and the average precision of the detections.

use std::{collections::BTreeMap, path::Path};

use rayon::prelude::*;
use serde::Serialize;
use unopose_dataset::formats::{BopSplit, Foreground, Target, detections::Detection, files::write_json};

use super::{
    EvalError,
    coco::{CocoScores, RegionKind, coco_scores},
};

/// Targets less visible than this do not count for the recall of proposals.
const MIN_TARGET_VISIBILITY: f64 = 0.3;

/// What `scores.json` of a segmentation holds.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct SegmentationScores {
    /// COCO's mean average precision of the detections' masks.
    #[serde(rename = "mAP")]
    pub map: f64,
    /// Share of the targets with a visible share of 0.3 or more that some proposal covers with an overlap (IoU) of 0.5.
    pub recall50: f64,
    /// The same with an overlap of 0.75.
    pub recall75: f64,
    /// Mean number of proposals, before they are matched with the references.
    pub proposals_per_image: f64,
    /// Seconds, proposals and matching.
    pub mean_time_per_image_s: f64,
    /// Seconds of the proposals alone.
    pub mean_proposal_time_per_image_s: f64,
    /// Targets that the recall counts.
    pub n_targets: usize,
    /// All scores of the detections' masks.
    pub detections: CocoScores,
}

impl SegmentationScores {
    /// Writes them as JSON to `path`.
    pub fn write(&self, path: &Path) -> Result<(), EvalError> {
        Ok(write_json(path, self, true)?)
    }
}

/// Scores detections and proposals of the images of `targets`; `seconds` are those of all images, of the whole and of the
/// proposals alone.
pub fn score_segmentation(
    split: &BopSplit,
    targets: &[Target],
    detections: &[Detection],
    proposals: &[Detection],
    [seconds, proposal_seconds]: [&[f64]; 2],
) -> Result<SegmentationScores, EvalError> {
    let scores = coco_scores(split, targets, detections, RegionKind::Mask)?;
    let mut by_image: BTreeMap<(u32, u32), Vec<Foreground>> = BTreeMap::new();
    for proposal in proposals {
        let image = by_image.entry((proposal.scene_id, proposal.image_id)).or_default();
        image.push(Foreground::new(&proposal.segmentation)?);
    }
    let best_overlap = |target: &Target| -> Result<Option<f64>, EvalError> {
        let scene = split.scene(target.scene_id)?;
        let index = scene.most_visible(target.im_id, target.obj_id)?.0;
        let visible = scene.gt_info(target.im_id)?.get(index).map_or(0.0, |info| info.visib_fract);
        if visible < MIN_TARGET_VISIBILITY {
            return Ok(None);
        }
        let mask = Foreground::of_mask(&scene.mask_visib(target.im_id, index)?);
        let image = by_image.get(&(target.scene_id, target.im_id));
        Ok(Some(image.into_iter().flatten().map(|p| p.iou(&mask)).fold(0.0, f64::max)))
    };
    let overlaps: Vec<Option<f64>> = targets.par_iter().map(best_overlap).collect::<Result<_, _>>()?;
    let overlaps: Vec<f64> = overlaps.into_iter().flatten().collect();
    let recall = |threshold: f64| {
        overlaps.iter().filter(|&&iou| iou >= threshold).count() as f64 / overlaps.len().max(1) as f64
    };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    Ok(SegmentationScores {
        map: scores.map,
        recall50: recall(0.5),
        recall75: recall(0.75),
        proposals_per_image: proposals.len() as f64 / seconds.len().max(1) as f64,
        mean_time_per_image_s: mean(seconds),
        mean_proposal_time_per_image_s: mean(proposal_seconds),
        n_targets: overlaps.len(),
        detections: scores,
    })
}
