//! Prepared pairs, encoded references and the poses of pairs.

use burn::tensor::Device;
use unopose_core::{config::ModelConfig, geometry::Pose};
use unopose_nn::model::{CloudTensors, EncodedCloud, UnoPose, group_tensors};
use unopose_pairs::data::{CloudInput, PreparedReference};

use super::Evidence;

/// Pose of one pair with what explains it.
#[derive(Clone, Copy, Debug)]
pub struct PairEstimate {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// Confidence in [0, 1]: share of matched query points that lie on the reference, times the share matched
    /// (`docs/network.md`, section 6; without a fine stage computed on the coarse matches).
    pub score: f64,
    /// Coarse pose, metres.
    pub t_query_reference_coarse: Pose,
    /// Score of the coarse hypothesis, see [`HypothesisScore`](unopose_core::config::HypothesisScore).
    pub coarse_score: f64,
    /// Mean predicted overlap of the query's and the reference's points.
    pub overlap: [f64; 2],
    /// Share of query points matched to a reference point.
    pub matched: f64,
    /// What speaks for the pose.
    pub evidence: Evidence,
}

/// Where the wall-clock time of a batch went; the time of pairs that pass side by side is divided among their stages.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct StageTimes {
    /// Colour features and structure embeddings, seconds.
    pub encode: f64,
    /// Coarse matching, seconds.
    pub coarse: f64,
    /// Hypotheses, seconds.
    pub hypotheses: f64,
    /// Positional encoding and fine matching, seconds.
    pub fine: f64,
    /// Weighted Procrustes and scoring, seconds.
    pub solve: f64,
}

impl StageTimes {
    /// Of one of `count` pairs.
    pub fn divided(&self, count: usize) -> Self {
        self.scaled(1.0 / count.max(1) as f64)
    }

    pub(super) fn scaled(&self, factor: f64) -> Self {
        Self {
            encode: self.encode * factor,
            coarse: self.coarse * factor,
            hypotheses: self.hypotheses * factor,
            fine: self.fine * factor,
            solve: self.solve * factor,
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.encode += other.encode;
        self.coarse += other.coarse;
        self.hypotheses += other.hypotheses;
        self.fine += other.fine;
        self.solve += other.solve;
    }

    /// Sum of the stages, seconds.
    pub fn total(&self) -> f64 {
        self.encode + self.coarse + self.hypotheses + self.fine + self.solve
    }
}

/// A query's cloud and the reference's, both in units of the reference's radius.
#[derive(Clone, Copy, Debug)]
pub struct CloudPair<'a> {
    /// The query as the network sees it.
    pub query: &'a CloudInput,
    /// The reference as the network sees it.
    pub reference: &'a CloudInput,
    /// The reference's, metres.
    pub radius: f32,
}

impl<'a> CloudPair<'a> {
    /// Of a prepared reference.
    pub fn new(query: &'a CloudInput, reference: &'a PreparedReference) -> Self {
        Self { query, reference: &reference.cloud, radius: reference.radius }
    }
}

/// Runs the reference's share of the network: everything that looks at no query.
pub fn encode_references(
    model: &UnoPose,
    config: &ModelConfig,
    references: &[&PreparedReference],
    device: &Device,
) -> EncodedCloud {
    let clouds: Vec<&CloudInput> = references.iter().map(|r| &r.cloud).collect();
    let encoded = model.encode(&CloudTensors::from_clouds(&clouds, config, device));
    with_positions(model, config, references, encoded, device)
}

/// Adds what the fine stage needs of the references, and the layers that can be computed ahead.
pub(super) fn with_positions(
    model: &UnoPose,
    config: &ModelConfig,
    references: &[&PreparedReference],
    encoded: EncodedCloud,
    device: &Device,
) -> EncodedCloud {
    let groups: Vec<_> = references.iter().map(|r| &r.groups).collect();
    let stage = model.fine_point_matching.as_ref();
    let position = stage.map(|stage| stage.position(&group_tensors(&groups, config, device)));
    model.with_self_attention(EncodedCloud { position, ..encoded })
}
