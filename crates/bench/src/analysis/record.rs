//! What is kept of one pair.

use serde::{Deserialize, Serialize};
use unopose_infer::Evidence;

/// One target against its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    pub(crate) scene_id: u32,
    pub(crate) im_id: u32,
    pub(crate) obj_id: u32,
    pub(crate) ref_scene_id: u32,
    pub(crate) ref_im_id: u32,
    /// Visible share of the target.
    pub(crate) visib_fract: f64,
    /// Rotation between the views, up to symmetry.
    pub(crate) rot_deg: f64,
    /// Of the object, metres.
    pub(crate) diameter: f64,
    /// Mean step of brightness between neighbouring pixels of the reference, grey levels.
    pub(crate) texture: f64,
    pub(crate) evidence: Evidence,
    /// Whether one of the poses among which it was chosen is right.
    pub(crate) has_right_candidate: bool,
    /// Calibrated, where the network has a calibration.
    pub(crate) probability: Option<f64>,
    /// Whether the pose is right, as [`PoseCriterion`](unopose_infer::PoseCriterion) defines it.
    pub right: bool,
    /// The target's part in the average recall with the network's pose, 0..=1.
    pub(crate) credit: f64,
    /// The same with the refined pose.
    pub(crate) refined_credit: f64,
    pub(crate) stages: StageMeasures,
}

/// Rotation (degrees) and translation (diameters) of the object against the truth, up to symmetry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PoseError {
    pub rotation_deg: f64,
    pub translation: f64,
}

/// Shares of a prediction and of the truth that agree; `None` where there is nothing to divide by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PrecisionRecall {
    /// Of the points predicted to overlap, those that do.
    pub precision: Option<f64>,
    /// Of the points that overlap, those predicted to.
    pub recall: Option<f64>,
}

/// Median angles between the local frames of the same places in both views, degrees; chance is about 132 for the frame and
/// 90 for its z axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FrameDifference {
    /// Of the rotation between the whole frames.
    pub frame_deg: f64,
    /// Between the z axes.
    pub normal_deg: f64,
}

/// The stages of one estimate against the truth; distances in radii of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StageMeasures {
    /// Share of the coarse matches within [`COARSE_DISTANCE`](super::measure::COARSE_DISTANCE) of the truth.
    pub coarse_inliers: Option<f64>,
    /// Chance that a match drawn for the hypotheses is such an inlier.
    pub drawn_inliers: Option<f64>,
    /// Smallest rotation error of all hypotheses, and of those that were kept, degrees.
    pub best_hypothesis_deg: Option<f64>,
    pub best_kept_deg: Option<f64>,
    pub coarse: PoseError,
    /// Median distance of the fine matches to the truth, of points that overlap.
    pub fine_distance: Option<f64>,
    /// Share of these points within [`FINE_DISTANCE`](super::measure::FINE_DISTANCE).
    pub fine_inliers: Option<f64>,
    /// After the fine stage.
    pub fine: PoseError,
    /// After the fine stage started from the truth.
    pub fine_from_truth: Option<PoseError>,
    /// After the refinement.
    pub refined: PoseError,
    /// After the refinement started from the truth.
    pub refined_truth: Option<PoseError>,
    /// Overlap predicted by the last stage for the query's and the reference's points.
    pub overlap_query: PrecisionRecall,
    pub overlap_reference: PrecisionRecall,
    /// Local frames of both balls of the positional encoding.
    pub local_frames: [Option<FrameDifference>; 2],
}
