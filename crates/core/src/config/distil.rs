//! Distillation of a colour encoder.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the colour encoder learns from a teacher and from true correspondences (`docs/network.md`, section 12).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DistilConfig {
    /// Side of the square colour crop that the teacher sees, pixels. A multiple of `model.image_size` and of the side of the
    /// teacher's patches.
    pub teacher_image_size: usize,
    /// Blocks of the teacher after which its tokens are read. The later ones know what an object is rather than where on it a
    /// point is.
    pub teacher_blocks: usize,
    /// Points per view whose features are compared, the first of the dense points.
    pub points: usize,
    /// Weight of one minus the cosine between mapped and teacher's features.
    pub feature_weight: f64,
    /// Weight of the mean squared difference between the cosines of all points of a pair, ours and the teacher's.
    pub structure_weight: f64,
    /// Weight of InfoNCE between the two views' points under the true pose.
    pub contrast_weight: f64,
    /// Divides the cosines of InfoNCE.
    pub temperature: f64,
}

impl Default for DistilConfig {
    fn default() -> Self {
        Self {
            teacher_image_size: 224,
            teacher_blocks: 9,
            points: 256,
            feature_weight: 1.0,
            structure_weight: 4.0,
            contrast_weight: 0.2,
            temperature: 0.1,
        }
    }
}
