//! Our own segmentation as rows of a table, one per source of proposals.

use std::{
    io::Write as _,
    path::{Path, PathBuf},
};

use serde::Serialize;
use unopose_core::files::{FileError, write_atomic};
use unopose_eval::eval::SegmentationScores;

use super::tables::{percent, seconds};

pub(super) const COLUMNS: [&str; 8] = [
    "proposals",
    "matcher",
    "mAP",
    "AP50",
    "recall at 0.5",
    "recall at 0.75",
    "proposals per image",
    "s per image",
];

/// Masks found by [`unopose_segment::segment`] with one source of proposals.
#[derive(Clone, Debug, Serialize)]
pub struct OwnMasks {
    /// Names of the proposal generator and of the matcher.
    pub proposals: String,
    pub matcher: String,
    #[serde(flatten)]
    pub scores: SegmentationScores,
    /// The file of detections.
    #[serde(skip)]
    pub detections: PathBuf,
}

impl OwnMasks {
    /// In the order of [`COLUMNS`].
    pub(super) fn cells(&self) -> Vec<String> {
        let s = &self.scores;
        vec![
            self.proposals.clone(),
            self.matcher.clone(),
            percent(s.map),
            percent(s.detections.ap50),
            percent(s.recall50),
            percent(s.recall75),
            format!("{:.1}", s.proposals_per_image),
            seconds(s.mean_time_per_image_s),
        ]
    }
}

pub(super) fn write_csv(rows: &[OwnMasks], path: &Path) -> Result<(), FileError> {
    write_atomic(path, |out| {
        let header = "proposals,matcher,map,ap50,recall50,recall75,targets,proposals_per_image,seconds_per_image,\
             proposal_seconds_per_image";
        writeln!(out, "{header}")?;
        rows.iter().try_for_each(|OwnMasks { proposals, matcher, scores: s, .. }| {
            writeln!(
                out,
                "{proposals},{matcher},{:.6},{:.6},{:.6},{:.6},{},{:.2},{:.4},{:.4}",
                s.map,
                s.detections.ap50,
                s.recall50,
                s.recall75,
                s.n_targets,
                s.proposals_per_image,
                s.mean_time_per_image_s,
                s.mean_proposal_time_per_image_s
            )
        })
    })
}
