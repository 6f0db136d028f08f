//! Our own masks of the targets of a BOP dataset, for `segment`, `eval` and `bench`.

use std::path::{Path, PathBuf};

use unopose_cli::{say, tell};
use unopose_dataset::formats::{
    BopSplit, DatasetSplits, Target,
    detections::write_detections,
    targets::{read_reference_targets, read_targets},
};
use unopose_eval::metrics::{SegmentationScores, score_segmentation};
use unopose_segment::{Matcher, ObjectViews, ProposalGenerator, Templates, UnoSeg, segment_targets};

use super::progress::ProgressDisplay;

/// What is said of images whose true poses and masks are kept secret.
pub const NOT_SCORED: &str = "no annotations: not scored";

/// Files of [`segment_dataset`].
pub struct DatasetFiles {
    pub splits: DatasetSplits,
    pub targets: PathBuf,
    pub limit: Option<usize>,
    /// Templates of each object's model instead of its reference view.
    pub templates: Option<usize>,
}

/// Detects all targets, writes `detections.json`, `proposals.json` and `scores.json` to `out` and returns the first's path
/// and the last's content, which images without annotations have not.
pub fn segment_dataset<M: Matcher>(
    files: &DatasetFiles,
    generator: &dyn ProposalGenerator,
    matcher: &M,
    out: &Path,
) -> anyhow::Result<(PathBuf, Option<SegmentationScores>)> {
    let dataset = files.splits.open()?;
    let (split, other) = (files.splits.of_targets(&dataset)?, files.splits.of_references(&dataset)?);
    let templates = files.templates.map(|count| Templates::new(&dataset, count)).transpose()?;
    let views = match &templates {
        Some(templates) => ObjectViews::Templates(templates),
        None => ObjectViews::References(other.as_ref().unwrap_or(&split)),
    };
    let mut targets = read_reference_targets(&files.targets)?;
    targets.truncate(files.limit.unwrap_or(usize::MAX).max(1));
    let unoseg = UnoSeg { generator, matcher };
    let progress = ProgressDisplay::new("segmenting");
    let show = &mut |done, total| progress.set(done, total);
    let found = segment_targets(&unoseg, &targets, &split, &views, &out.join("images"), show)?;
    progress.finish();
    for (object, reason) in &found.unusable {
        tell!("{object}: {reason}");
    }
    let path = out.join("detections.json");
    write_detections(&path, &found.detections)?;
    write_detections(&out.join("proposals.json"), &found.proposals)?;
    let mut all = read_targets(&files.targets)?;
    all.retain(|t| {
        targets.iter().any(|r| (r.scene_id, r.im_id, r.obj_id) == (t.scene_id, t.im_id, t.obj_id))
            && is_annotated(&split, t)
    });
    if all.is_empty() {
        say!("{NOT_SCORED}\n{}", path.display());
        return Ok((path, None));
    }
    let seconds = [found.seconds.as_slice(), &found.proposal_seconds];
    let scores = score_segmentation(&split, &all, &found.detections, &found.proposals, seconds)?;
    scores.write(&out.join("scores.json"))?;
    say!(
        "segmentation: mAP {:.3}, AP50 {:.3}; proposals: recall {:.3} at 0.5, {:.3} at 0.75 of {} targets, {:.1} per image; \
         {:.3} s per image, {:.3} s of it proposals",
        scores.map,
        scores.detections.ap50,
        scores.recall50,
        scores.recall75,
        scores.n_targets,
        scores.proposals_per_image,
        scores.mean_time_per_image_s,
        scores.mean_proposal_time_per_image_s
    );
    say!("{}", path.display());
    Ok((path, Some(scores)))
}

/// Is it known what the target's image shows? Where that cannot be read it is told.
fn is_annotated(split: &BopSplit, target: &Target) -> bool {
    let Ok(scene) = split.scene(target.scene_id) else { return false };
    if !scene.is_annotated(target.im_id) {
        return false;
    }
    let visible = scene.gt_info(target.im_id);
    visible.inspect_err(|error| tell!("{error}: the image does not count")).is_ok()
}
