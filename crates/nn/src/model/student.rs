//! A colour encoder that learns from another network's features.

use burn::{
    module::Module,
    nn::Linear,
    tensor::{Device, Tensor},
};
use unopose_core::config::ModelConfig;

use super::{FeatureExtraction, Initializer, PixelChoice};

/// The colour encoder of a pose network, under the names it has there, and a linear map from its features to the teacher's.
#[derive(Module, Debug)]
pub struct Student {
    /// What a pose network takes over.
    pub feature_extraction: FeatureExtraction,
    /// `C_color` to the teacher's channels.
    pub head: Linear,
}

impl Student {
    /// Initial weights.
    pub fn new(config: &ModelConfig, teacher_channels: usize, seed: u64, device: &Device) -> Self {
        let init = &mut Initializer::new(seed, device);
        Self {
            feature_extraction: FeatureExtraction::new(config, init),
            head: init.linear(config.color.out_dim(), teacher_channels),
        }
    }

    /// Features `[B, N, C_color]` of normalised crops `[B, 3, S, S]` at the chosen pixels.
    pub fn features(&self, images: Tensor<4>, choose: &PixelChoice) -> Tensor<3> {
        self.feature_extraction.forward(images, choose)
    }
}
