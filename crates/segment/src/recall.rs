//! How well proposals cover the objects of annotated images.

use std::time::Instant;

use serde::Serialize;
use unopose_dataset::formats::BopSplit;

use super::{ProposalGenerator, SegmentError};

/// Smallest visible share of an object that counts.
const LEAST_VISIBLE: f64 = 0.1;

/// Recall of the proposals of a generator.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ProposalScores {
    /// Name of the generator.
    pub proposals: String,
    /// Images.
    pub images: usize,
    /// Objects of which at least a tenth is visible.
    pub objects: usize,
    /// Share of them with a proposal whose overlap (intersection over union) is at least 0.5.
    pub recall_50: f64,
    /// The same at 0.75.
    pub recall_75: f64,
    /// Mean over the objects of the best proposal's overlap.
    pub mean_iou: f64,
    /// Share of the objects of which one of the image's first `n` proposals has an overlap of at least 0.75, `n` being the
    /// number of its objects: how well they are ranked.
    pub first_75: f64,
    /// Mean number of proposals per image.
    pub per_image: f64,
    /// Mean time per image, seconds.
    pub seconds: f64,
}

/// Recall on the annotated images of a split, at most `limit` of them. `progress` is called with the images done and all images.
pub fn proposal_scores(
    generator: &dyn ProposalGenerator,
    split: &BopSplit,
    limit: usize,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<ProposalScores, SegmentError> {
    let images = annotated_images(split, limit)?;
    let (mut best, mut first, mut proposed, mut seconds) = (Vec::new(), Vec::new(), 0, 0.0);
    for (done, &(scene_id, im_id)) in images.iter().enumerate() {
        progress(done, images.len());
        let annotated = split.load(scene_id, im_id)?;
        let start = Instant::now();
        let proposals = generator.proposals(&annotated.frame, Some((scene_id, im_id)))?;
        seconds += start.elapsed().as_secs_f64();
        proposed += proposals.len();
        let visible = |visib_fract: f64, pixels: usize| visib_fract >= LEAST_VISIBLE && pixels > 0;
        let objects: Vec<_> =
            annotated.instances.iter().filter(|i| visible(i.visib_fract, i.mask_visib.count())).collect();
        for object in &objects {
            let overlaps: Vec<f64> = proposals.iter().map(|p| p.mask.iou(&object.mask_visib)).collect();
            let largest = |overlaps: &[f64]| overlaps.iter().copied().fold(0.0, f64::max);
            best.push(largest(&overlaps));
            first.push(largest(&overlaps[..objects.len().min(overlaps.len())]));
        }
    }
    progress(images.len(), images.len());
    let count = best.len().max(1) as f64;
    let share =
        |overlaps: &[f64], least: f64| overlaps.iter().filter(|&&o| o >= least).count() as f64 / count;
    Ok(ProposalScores {
        proposals: generator.name(),
        images: images.len(),
        objects: best.len(),
        recall_50: share(&best, 0.5),
        recall_75: share(&best, 0.75),
        mean_iou: best.iter().sum::<f64>() / count,
        first_75: share(&first, 0.75),
        per_image: proposed as f64 / images.len().max(1) as f64,
        seconds: seconds / images.len().max(1) as f64,
    })
}

/// Scene id and image id of the annotated images, at most `limit`.
pub(super) fn annotated_images(split: &BopSplit, limit: usize) -> Result<Vec<(u32, u32)>, SegmentError> {
    let mut images = Vec::new();
    for &scene_id in split.scene_ids() {
        let scene = split.scene(scene_id)?;
        images.extend(scene.image_ids().filter(|&im| scene.is_annotated(im)).map(|im| (scene_id, im)));
    }
    images.truncate(limit);
    Ok(images)
}
