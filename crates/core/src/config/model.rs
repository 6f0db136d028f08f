//! Sizes and switches of the network.

use serde::{Deserialize, Serialize};

use super::{ColorConfig, Quirks, VitConfig};

/// The network and the preparation of its inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Side of the square, masked colour crop in pixels.
    pub image_size: usize,
    /// Reference points sampled before farthest point sampling.
    pub reference_points: usize,
    /// Reference points farther from the median point than this many median distances are dropped before sampling:
    /// one stray depth pixel at a silhouette would stretch the radius, the unit of everything. 0: none are, as in
    /// the release.
    pub reference_reach: f32,
    /// Points per cloud in the fine stage (N_f).
    pub fine_points: usize,
    /// Points per cloud in the coarse stage (N_c).
    pub coarse_points: usize,
    pub color: ColorConfig,
    pub geo_embedding: GeoEmbeddingConfig,
    pub coarse: MatchingConfig,
    pub fine: FineConfig,
    /// Structure embedding from the global reference frame (true) or from the camera-frame cloud (false).
    pub use_grf: bool,
    /// Run the fine stage; without it the coarse pose is the answer.
    pub use_fine: bool,
    /// How overlap scores weigh the matches.
    pub overlap: OverlapMode,
    pub hypotheses: HypothesisConfig,
    pub quirks: Quirks,
}

/// Geometric structure embedding (GeoTransformer).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GeoEmbeddingConfig {
    /// Distance unit, radii.
    pub sigma_d: f32,
    /// Angle unit, degrees.
    pub sigma_a: f32,
    /// Neighbours per point for the triplet angles.
    pub angle_k: usize,
    /// Width, equal to the width of both matching stages.
    pub hidden_dim: usize,
    /// How the two linear maps of the sinusoids are evaluated.
    pub evaluation: EmbeddingEvaluation,
}

/// Evaluation of `proj(sinusoid(x))` for every pair of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EmbeddingEvaluation {
    /// Sinusoid and linear map per entry, as the release does.
    Exact,
    /// Linear interpolation in a table of the mapped sinusoid, rebuilt from the weights in every forward pass.
    Table,
}

/// One matching stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatchingConfig {
    pub blocks: usize,
    pub heads: usize,
    /// Width of the transformer.
    pub hidden_dim: usize,
    /// Width of the matching features.
    pub out_dim: usize,
    /// Softmax temperature of the cosine similarity.
    pub temperature: f32,
}

/// The fine stage's additions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FineConfig {
    pub matching: MatchingConfig,
    /// Radii of the two ball queries of the positional encoding, in radii.
    pub pe_radii: [f32; 2],
    /// Neighbours per ball.
    pub pe_samples: [usize; 2],
    /// Channels of the positional encoding's three layers, for each of the two balls.
    pub pe_channels: [usize; 3],
    /// Local-reference-frame coordinates in the positional encoding (with the offsets).
    pub use_lrf: bool,
    /// Exponent of the focused linear attention.
    pub focusing_factor: f32,
}

/// Use of the predicted overlap in the assignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OverlapMode {
    /// Row softmax x column softmax x both overlap scores.
    Release,
    /// One softmax over the similarities of overlap-weighted features (paper, "overlap-aware correlation matrix"); the
    /// background's overlap is predicted and trained towards 0.
    Paper,
    /// No overlap heads.
    Off,
}

/// Coarse pose from sampled correspondence triplets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HypothesisConfig {
    /// Sampled triplets.
    pub proposals: usize,
    /// Triplets kept by residual and scored against the cloud.
    pub kept: usize,
    /// Exponent of the assignment when sampling.
    pub power: f32,
    /// How the kept are scored.
    pub score: HypothesisScore,
}

/// Score of a hypothesis; the best one starts the fine stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HypothesisScore {
    /// Matched sparse query points over the sum of their distances to the sparse reference points (paper and release).
    #[default]
    Distance,
    /// Share of the dense query points that lie on the reference times that of the reference's on the query, each point
    /// weighed by its distance.
    MutualFit,
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            image_size: 224,
            reference_points: 5000,
            reference_reach: 0.0,
            fine_points: 2048,
            coarse_points: 196,
            color: ColorConfig::Vit(VitConfig::default()),
            geo_embedding: GeoEmbeddingConfig::default(),
            coarse: MatchingConfig::default(),
            fine: FineConfig::default(),
            use_grf: true,
            use_fine: true,
            overlap: OverlapMode::Release,
            hypotheses: HypothesisConfig::default(),
            quirks: Quirks::default(),
        }
    }
}

impl Default for GeoEmbeddingConfig {
    fn default() -> Self {
        Self {
            sigma_d: 0.2,
            sigma_a: 15.0,
            angle_k: 3,
            hidden_dim: 256,
            evaluation: EmbeddingEvaluation::Table,
        }
    }
}

impl Default for MatchingConfig {
    fn default() -> Self {
        Self { blocks: 3, heads: 4, hidden_dim: 256, out_dim: 256, temperature: 0.1 }
    }
}

impl Default for FineConfig {
    fn default() -> Self {
        Self {
            matching: MatchingConfig::default(),
            pe_radii: [0.1, 0.2],
            pe_samples: [64, 256],
            pe_channels: [32, 64, 128],
            use_lrf: true,
            focusing_factor: 3.0,
        }
    }
}

impl Default for HypothesisConfig {
    fn default() -> Self {
        Self { proposals: 6000, kept: 300, power: 1.5, score: HypothesisScore::default() }
    }
}
