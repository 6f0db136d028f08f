//! Colour encoders.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Encoder of the colour crop, from which each point takes its colour feature.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ColorConfig {
    /// DINOv2-style vision transformer with learned up-sampling to a quarter of the crop's resolution.
    Vit(VitConfig),
    /// Small trainable convolutional encoder, sampled at the points on three levels.
    Conv {
        /// Channels at half, quarter and eighth resolution.
        channels: [usize; 3],
        /// Channels of the point features.
        out_dim: usize,
    },
    /// Trainable convolutions to a quarter of the crop's resolution and transformer blocks at an eighth, sampled at the
    /// points on three levels.
    Hybrid(HybridConfig),
    /// Geometry only: every point gets the same learned vector.
    None {
        /// Channels of the constant feature.
        out_dim: usize,
    },
}

/// Vision transformer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VitConfig {
    /// Channels of a token.
    pub embed_dim: usize,
    /// Transformer blocks. The features of the last block and of three earlier ones are used.
    pub depth: usize,
    /// Attention heads per block.
    pub heads: usize,
    /// Side of a square patch, pixels of the crop.
    pub patch_size: usize,
    /// Register tokens beside the class token. 0: none, as in the first DINOv2 weights.
    pub register_tokens: usize,
    /// The position embedding has no entry for the class token, as in timm's variants with registers.
    pub no_embed_class: bool,
    /// Channels of the up-sampled feature map.
    pub out_dim: usize,
    /// File of DINOv2 weights that training starts from: safetensors or PyTorch, in the naming of Meta, timm or Hugging
    /// Face. Unset: random weights. A checkpoint holds the transformer's weights and does not need this file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// How the position embedding of `weights` is resampled to this network's number of patches.
    pub position_resampling: PositionResampling,
    /// Keep the transformer's weights fixed in training. The up-sampling is always trained.
    pub freeze: bool,
}

/// Convolutions, then transformer blocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HybridConfig {
    /// Channels of the convolutions at half and quarter resolution.
    pub channels: [usize; 2],
    /// Channels of a token; there is one per 8 x 8 pixels of the crop.
    pub embed_dim: usize,
    /// Transformer blocks.
    pub depth: usize,
    /// Attention heads per block.
    pub heads: usize,
    /// Channels of the point features.
    pub out_dim: usize,
    /// Checkpoint of a distilled encoder (`unotrain distil`) that training starts from. Unset: random weights. A checkpoint
    /// of the whole network holds the encoder and does not need this file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
}

/// Resampling of a backbone's position embedding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PositionResampling {
    /// As the publisher of the file does it.
    Source,
    /// As the release of UNOPose does it with every file: bicubic without antialiasing.
    Release,
}

impl ColorConfig {
    /// Channels of a point's colour feature.
    pub fn out_dim(&self) -> usize {
        match self {
            Self::Vit(vit) => vit.out_dim,
            Self::Hybrid(hybrid) => hybrid.out_dim,
            Self::Conv { out_dim, .. } | Self::None { out_dim } => *out_dim,
        }
    }
}

impl Default for VitConfig {
    fn default() -> Self {
        Self {
            embed_dim: 768,
            depth: 12,
            heads: 12,
            patch_size: 14,
            register_tokens: 4,
            no_embed_class: true,
            out_dim: 256,
            weights: None,
            position_resampling: PositionResampling::Source,
            freeze: true,
        }
    }
}

impl Default for HybridConfig {
    fn default() -> Self {
        Self { channels: [32, 64], embed_dim: 192, depth: 4, heads: 3, out_dim: 64, weights: None }
    }
}
