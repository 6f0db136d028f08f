//! Scoring of estimated poses and detections: VSD, MSSD, MSPD and their average recalls as in the BOP challenges since 2019,
//! mean average precisions as in the later ones, ADD and ADD-S, angular errors, and COCO's mAP.
//!
//! [`score_files`] scores a result table of a dataset folder, [`score_poses`] poses in memory; both give the [`Scores`] that
//! `scores.json` holds and the errors of every target. The metrics follow the official
//! toolkit, metres instead of millimetres. Images are scored in parallel, one depth image per thread in
//! memory.

mod accuracy;
mod average_precision;
mod benchmark;
mod bins;
mod bootstrap;
mod coco;
mod error;
mod feature_match;
mod input_report;
mod matching;
mod object;
mod options;
mod outcome;
mod pose_detection;
mod pose_error;
mod prints;
mod reliability;
mod scored_image;
mod scores;
mod scoring;
mod segmentation;
mod vsd;

pub use accuracy::PoseAccuracy;
pub use benchmark::{score_poses, write_poses};
pub use bins::{ROTATION_EDGES, VISIBILITY_EDGES};
pub use bootstrap::{Interval, average_recall_interval, error_type_intervals, paired_difference};
pub use coco::{CocoScores, RegionKind, coco_scores};
pub use error::EvalError;
pub use feature_match::{FeatureSimilarity, match_area};
pub use input_report::InputReport;
pub use object::EvalObject;
pub use outcome::{PoseErrors, TargetOutcome};
pub use pose_detection::PoseAveragePrecision;
pub use prints::{PrintScore, print_decided_objects};
pub use reliability::{Reliability, ReliabilityBin};
pub use scores::{AverageRecall, BinScore, Scores};
pub use scoring::{Evaluation, ScoreFiles, score_files};
pub use segmentation::{SegmentationScores, score_segmentation};
pub use vsd::TestView;

/// Number of misalignment tolerances of VSD.
const TAUS: usize = 10;
/// Number of thresholds of correctness.
const THRESHOLDS: usize = 10;
/// Pixels between the thresholds of MSPD in an image of [`REFERENCE_WIDTH`].
const MSPD_STEP: f64 = 5.0;
/// Image width that MSPD's thresholds are meant for.
const REFERENCE_WIDTH: f64 = 640.0;

/// Tolerance, or threshold of correctness, number `index`: 0.05, 0.1, ... 0.5.
fn threshold(index: usize) -> f64 {
    0.05 + 0.05 * index as f64
}

#[cfg(test)]
mod input_tests;
#[cfg(test)]
mod list_tests;
#[cfg(test)]
mod tests;
