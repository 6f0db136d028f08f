//! Weights and thresholds of the training losses.

use serde::{Deserialize, Serialize};

/// The training loss: per stage and block InfoNCE + overlap + saliency.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Matches farther than this are background in InfoNCE, radii. The paper gives no such distance; a large one is none.
    pub match_distance: f32,
    /// A point overlaps when the other cloud has a point at most this far, radii.
    pub overlap_distance: f32,
    /// The two directions of InfoNCE are averaged (release) rather than summed (paper).
    pub halve_info_nce: bool,
    /// Weight of the saliency terms (the paper has none: 0).
    pub saliency_weight: f32,
    /// Weight of the overlap terms.
    pub overlap_weight: f32,
    /// Weight of the soft correspondence loss (CoFiNet), the paper's alternative to the overlap predictor.
    pub correspondence_weight: f32,
    /// The loss of one pair is clamped here.
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
            clamp: 100.0,
        }
    }
}
