//! Sizes and switches of the network.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ColorConfig, Quirks, VitConfig};

/// The network and the preparation of its inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModelConfig {
    /// Side of the square, masked colour crop, pixels.
    pub image_size: usize,
    /// Reference points sampled before farthest point sampling.
    pub reference_points: usize,
    /// Reference points farther from the median point than this many median distances are dropped before sampling. One
    /// stray depth pixel at a silhouette would otherwise stretch the object's radius, which all lengths are divided by. 0:
    /// none are dropped, as in the release.
    pub reference_reach: f32,
    /// Points per cloud in the fine stage (N_f).
    pub fine_points: usize,
    /// Points per cloud in the coarse stage (N_c).
    pub coarse_points: usize,
    /// Encoder of the colour crop.
    pub color: ColorConfig,
    /// Geometric structure embedding, shared by both matching stages.
    pub geo_embedding: GeoEmbeddingConfig,
    /// The coarse matching stage, on `coarse_points` per cloud.
    pub coarse: MatchingConfig,
    /// The fine matching stage, on `fine_points` per cloud.
    pub fine: FineConfig,
    /// Compute the structure embedding in the global reference frame (true) or in the camera frame (false).
    pub use_grf: bool,
    /// Run the fine stage; without it the coarse pose is the answer.
    pub use_fine: bool,
    /// How overlap scores weigh the matches.
    pub overlap: OverlapMode,
    /// Search of the coarse pose.
    pub hypotheses: HypothesisConfig,
    /// Behaviours of the release to reproduce.
    pub quirks: Quirks,
}

/// Geometric structure embedding (GeoTransformer).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GeoEmbeddingConfig {
    /// Distance that counts as one unit in the sinusoids, object radii.
    pub sigma_d: f32,
    /// Angle that counts as one unit in the sinusoids, degrees.
    pub sigma_a: f32,
    /// Neighbours per point for the triplet angles.
    pub angle_k: usize,
    /// Channels, equal to those of both matching stages.
    pub hidden_dim: usize,
    /// How the two linear maps of the sinusoids are evaluated.
    pub evaluation: EmbeddingEvaluation,
}

/// Evaluation of `proj(sinusoid(x))` for every pair of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EmbeddingEvaluation {
    /// Sinusoid and linear map per entry, as the release does.
    Exact,
    /// Linear interpolation in a table of the mapped sinusoid, which is made from the weights in every forward pass.
    Table,
}

/// One matching stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MatchingConfig {
    /// Transformer blocks, each of self-attention and cross-attention.
    pub blocks: usize,
    /// Attention heads per layer.
    pub heads: usize,
    /// Channels of the transformer.
    pub hidden_dim: usize,
    /// Channels of the matching features.
    pub out_dim: usize,
    /// Softmax temperature of the cosine similarity, without unit.
    pub temperature: f32,
}

/// The fine matching stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FineConfig {
    /// Sizes that the fine stage has in common with the coarse one.
    pub matching: MatchingConfig,
    /// Radii of the two ball queries of the positional encoding, object radii.
    pub pe_radii: [f32; 2],
    /// Neighbours per ball query.
    pub pe_samples: [usize; 2],
    /// Channels of the positional encoding's three layers, the same for both ball queries.
    pub pe_channels: [usize; 3],
    /// Give the positional encoding the neighbours' coordinates in local reference frames, besides their offsets.
    pub use_lrf: bool,
    /// Exponent of the focused linear attention.
    pub focusing_factor: f32,
}

/// Use of the predicted overlap in the assignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OverlapMode {
    /// Product of row softmax, column softmax and both overlap scores.
    Release,
    /// One softmax over the similarities of overlap-weighted features, the paper's "overlap-aware correlation matrix". The
    /// background's overlap is predicted and trained towards 0.
    Paper,
    /// No overlap heads.
    Off,
}

/// Coarse pose from sampled correspondence triplets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HypothesisConfig {
    /// Sampled triplets of matches.
    pub proposals: usize,
    /// Triplets with the smallest residuals that are scored against the cloud.
    pub kept: usize,
    /// Exponent of the assignment scores when matches are sampled.
    pub power: f32,
    /// How the kept triplets are scored.
    pub score: HypothesisScore,
    /// Exponent of the colours' agreement: a pose's score is multiplied by exp(weight * correlation), the correlation of the
    /// colours of the surface that both views see. 0: the shape alone decides.
    pub color_weight: f32,
    /// Exponent of the colour encoder's agreement: a pose's score is multiplied by exp(weight * cosine), the mean cosine between
    /// the features of points that it brings together. 0: they decide nothing.
    pub feature_weight: f32,
    /// Exponent of the free space: a pose's score is multiplied by exp(-weight * share), the share of the surface that would
    /// lie in space that a camera sees through.
    pub free_space_weight: f32,
    /// Fine stages from different hypotheses, of which the best scored result is taken.
    pub starts: usize,
    /// Turns of the pose of a body of revolution about its axis, which the shape hardly tells apart, that are refined and judged
    /// beside it. Needs the judgement by colours or free space.
    pub turns: usize,
}

impl HypothesisConfig {
    /// Whether poses are judged by the views' colours or free space.
    pub fn uses_appearance(&self) -> bool {
        self.color_weight != 0.0 || self.free_space_weight != 0.0
    }
}

/// Score of a hypothesis; the best one starts the fine stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HypothesisScore {
    /// Matched sparse query points over the sum of their distances to the sparse reference points (paper and release).
    #[default]
    Distance,
    /// Share of the dense query points that lie on the reference, times the share of the dense reference points that lie on
    /// the query. Each point is weighted by its distance.
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
        Self {
            proposals: 6000,
            kept: 300,
            power: 1.5,
            score: HypothesisScore::default(),
            color_weight: 0.0,
            feature_weight: 0.0,
            free_space_weight: 0.0,
            starts: 1,
            turns: 0,
        }
    }
}
