//! Weights and thresholds of the training losses.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The training loss: per stage and block InfoNCE + overlap + saliency.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Pairs of points farther apart than this are background in InfoNCE, object radii. The paper gives no such distance; a
    /// large value switches it off.
    pub match_distance: f32,
    /// A point overlaps when the other cloud has a point at most this far away, object radii.
    pub overlap_distance: f32,
    /// Average the two directions of InfoNCE as the release does (true), or sum them as in the paper (false).
    pub halve_info_nce: bool,
    /// Weight of the saliency terms. 0: none, as in the paper.
    pub saliency_weight: f32,
    /// Weight of the overlap terms.
    pub overlap_weight: f32,
    /// Weight of the soft correspondence loss (CoFiNet), the paper's alternative to the overlap predictor. 0: none.
    pub correspondence_weight: f32,
    /// Checkpoint of a distilled encoder of the same kind whose structure the colour features keep. Unset: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept_encoder: Option<PathBuf>,
    /// Weight of the mean squared difference between the cosines of a pair's colour features and of those that `kept_encoder`
    /// gives, so that training does not forget what was distilled.
    pub kept_structure_weight: f32,
    /// Largest loss of one pair, without what is kept; larger losses are clamped.
    pub clamp: f32,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            match_distance: 0.3,
            overlap_distance: 0.15,
            halve_info_nce: true,
            saliency_weight: 1.0,
            overlap_weight: 1.0,
            correspondence_weight: 0.0,
            kept_encoder: None,
            kept_structure_weight: 1.0,
            clamp: 100.0,
        }
    }
}
