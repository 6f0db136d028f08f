//! What goes into an estimate and what comes out of it.

use serde::Serialize;
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_pairs::{data::CloudInput, registration::Axis};

use super::{Confidence, Evidence, PairTrace, Reference, StageTimes};

/// A query instance and the reference it is compared with.
#[derive(Clone, Copy)]
pub struct Query<'a> {
    /// The object.
    pub reference: &'a Reference,
    /// The view that shows the instance.
    pub frame: &'a RgbdFrame,
    /// Pixels of the instance.
    pub mask: &'a Mask,
}

/// The pose of one instance with what explains it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Estimate {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// BOP score in [0, 1]: share of the query's points that are matched and lie on the reference.
    pub score: f64,
    /// Calibrated probability that the pose is right, with reasons where it is low; `None` when the checkpoint has no
    /// calibration.
    pub confidence: Option<Confidence>,
    /// What the confidence is made of.
    pub evidence: Evidence,
    /// Poses that the evidence hardly tells from this one, the best first; empty for an unambiguous answer.
    pub alternatives: Vec<Alternative>,
    /// Axis in the reference camera's frame about which the evidence leaves the pose free, as of a plain can.
    pub free_axis: Option<Axis>,
    /// Predicted share of the query's points that the reference sees, and of the reference's that the query sees.
    pub overlap: [f64; 2],
    /// Share of the query's points matched to a reference point.
    pub matched: f64,
    /// The pose of the coarse stage, metres.
    pub t_query_reference_coarse: Pose,
    /// Whether a refinement replaced the network's pose.
    pub refined: bool,
    /// Seconds.
    pub timings: Timings,
}

/// Another pose that may be the right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alternative {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// What speaks for it, in shares of what speaks for the answer, 0..=1.
    pub score: f64,
}

/// An estimate with the way to it.
pub struct Trace {
    /// As without a trace.
    pub estimate: Estimate,
    /// Both stages.
    pub stages: PairTrace,
    /// The query as the network sees it.
    pub cloud: CloudInput,
    /// The poses among which the answer was chosen: reference to query camera, metres.
    pub candidates: Vec<Pose>,
}

/// Seconds per instance; what a batch shares is divided evenly.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Timings {
    /// Crop, sampling, reference frame, structure.
    pub prepare: f64,
    /// The network's stages.
    #[serde(flatten)]
    pub network: StageTimes,
    /// Refinement and back-projection.
    pub refine: f64,
    /// Sum of the above.
    pub total: f64,
}
