//! Masks found by UNOSeg as rows of a table, one per source of proposals.

use std::path::PathBuf;

use serde::Serialize;
use unopose_eval::metrics::SegmentationScores;

use super::{
    cells::{percent, seconds},
    section::Section,
};

/// Masks found by [`unopose_segment::segment_targets`] with one source of proposals.
#[derive(Clone, Debug, Serialize)]
pub struct UnoSegMasks {
    /// Name of the proposal generator.
    pub proposals: String,
    /// Name of the matcher.
    pub matcher: String,
    /// Accuracy against the annotated masks, and times.
    #[serde(flatten)]
    pub scores: SegmentationScores,
    /// The file of detections.
    #[serde(skip)]
    pub detections: PathBuf,
}

/// Accuracy and time, rounded.
pub(crate) fn section(masks: &[UnoSegMasks]) -> Section {
    let columns = [
        "proposals",
        "matcher",
        "mAP",
        "AP50",
        "recall at 0.5",
        "recall at 0.75",
        "proposals per image",
        "s per image",
    ];
    let row = |UnoSegMasks { proposals, matcher, scores: s, .. }: &UnoSegMasks| {
        vec![
            proposals.clone(),
            matcher.clone(),
            percent(s.map),
            percent(s.detections.ap50),
            percent(s.recall50),
            percent(s.recall75),
            format!("{:.1}", s.proposals_per_image),
            seconds(s.mean_time_per_image_s),
        ]
    };
    Section::table(columns, masks.iter().map(row))
}

/// Accuracy and time, unrounded.
pub(crate) fn csv(masks: &[UnoSegMasks]) -> Section {
    let columns = [
        "proposals",
        "matcher",
        "map",
        "ap50",
        "recall50",
        "recall75",
        "targets",
        "proposals_per_image",
        "seconds_per_image",
        "proposal_seconds_per_image",
    ];
    let row = |UnoSegMasks { proposals, matcher, scores: s, .. }: &UnoSegMasks| {
        vec![
            proposals.clone(),
            matcher.clone(),
            format!("{:.6}", s.map),
            format!("{:.6}", s.detections.ap50),
            format!("{:.6}", s.recall50),
            format!("{:.6}", s.recall75),
            s.n_targets.to_string(),
            format!("{:.2}", s.proposals_per_image),
            format!("{:.4}", s.mean_time_per_image_s),
            format!("{:.4}", s.mean_proposal_time_per_image_s),
        ]
    };
    Section::table(columns, masks.iter().map(row))
}
