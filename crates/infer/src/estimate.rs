//! What goes into an estimate and what comes out of it.

use serde::Serialize;
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_pairs::data::CloudInput;

use super::{Confidence, Evidence, PairTrace, Reference, StageTimes};

/// A query instance and the reference it is compared with.
#[derive(Clone, Copy)]
pub struct Query<'a> {
    pub reference: &'a Reference,
    pub frame: &'a RgbdFrame,
    pub mask: &'a Mask,
}

/// The pose of one instance with what explains it.
#[derive(Clone, Debug)]
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
    /// Predicted share of the query's points that the reference sees, and of the reference's that the query sees.
    pub overlap: [f64; 2],
    /// Share of the query's points matched to a reference point.
    pub matched: f64,
    /// The pose of the coarse stage, metres.
    pub t_query_reference_coarse: Pose,
    /// Whether a refinement replaced the network's pose.
    pub refined: bool,
    pub timings: Timings,
}

/// An estimate with the way to it.
pub struct Trace {
    pub estimate: Estimate,
    pub stages: PairTrace,
    /// The query as the network sees it.
    pub cloud: CloudInput,
}

/// Seconds per instance; what a batch shares is divided evenly.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Timings {
    /// Crop, sampling, reference frame, structure.
    pub prepare: f64,
    #[serde(flatten)]
    pub network: StageTimes,
    pub refine: f64,
    pub total: f64,
}
