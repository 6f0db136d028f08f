//! The network whose features are learned.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use unopose_core::config::{Config, ConfigError, ModelConfig};
use unopose_nn::{
    checkpoint::load_transformer,
    model::{PixelChoice, ViewTensors, VisionTransformer},
};

use crate::TrainError;

/// A DINOv2 transformer without gradients, for crops of `distil.teacher_image_size` pixels.
pub struct Teacher {
    network: VisionTransformer,
    image_size: usize,
    blocks: usize,
    channels: usize,
}

impl Teacher {
    /// Reads a backbone file; `device` is without autodiff.
    pub fn load(path: &Path, config: &Config, device: &Device) -> Result<Self, TrainError> {
        let (image_size, own) = (config.distil.teacher_image_size, config.model.image_size);
        let wrong = |field: &str, value: usize, expected: String| {
            TrainError::Config(ConfigError::Range { field: field.into(), value: value.to_string(), expected })
        };
        if !image_size.is_multiple_of(own) {
            let expected = format!("a multiple of model.image_size = {own}");
            return Err(wrong("distil.teacher_image_size", image_size, expected));
        }
        if config.distil.points > config.model.fine_points {
            let expected = format!("at most model.fine_points = {}", config.model.fine_points);
            return Err(wrong("distil.points", config.distil.points, expected));
        }
        let network = load_transformer(path, image_size, device)?;
        let blocks = config.distil.teacher_blocks;
        if blocks > network.depth() {
            let expected = format!("at most {}, the blocks of {}", network.depth(), path.display());
            return Err(wrong("distil.teacher_blocks", blocks, expected));
        }
        Ok(Self { channels: network.channels(), network, image_size, blocks })
    }

    /// Channels of a feature.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Patch tokens of crops `[B, 3, T, T]` after `distil.teacher_blocks` blocks, sampled bilinearly at the points:
    /// `[B, N, channels]`.
    pub fn features(&self, images: Tensor<4>, choose: &PixelChoice) -> Tensor<3> {
        choose.sample_grid(self.network.tokens_after(images, self.blocks), self.image_size)
    }

    /// What pairs are prepared with: crops of the teacher's size, and nothing that only poses need.
    pub fn preparation(config: &Config) -> ModelConfig {
        ModelConfig {
            image_size: config.distil.teacher_image_size,
            use_fine: false,
            hypotheses: Default::default(),
            ..config.model.clone()
        }
    }

    /// The views as the student sees them: crops reduced to `model.image_size` by the mean over squares of pixels.
    pub fn reduced(&self, view: &ViewTensors, config: &ModelConfig) -> ViewTensors {
        let factor = self.image_size / config.image_size;
        let side = config.image_size;
        let [batch, channels, ..] = view.images.dims();
        let squares = view.images.clone().reshape([batch * channels, side, factor, side * factor]);
        let rows = squares.mean_dim(2).reshape([batch * channels, side, side, factor]);
        ViewTensors {
            images: rows.mean_dim(3).reshape([batch, channels, side, side]),
            choose: view.choose.reduced(self.image_size, factor),
        }
    }
}
