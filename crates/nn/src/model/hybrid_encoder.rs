//! Trainable colour encoder of about two million weights: convolutions to a quarter of the resolution, then transformer blocks
//! on one token per 8 x 8 pixels, which see the whole crop. Read out at the points only.

use burn::{
    module::{Module, Param},
    nn::{LayerNorm, conv::Conv2d},
    tensor::{Tensor, activation::relu},
};
use unopose_core::config::HybridConfig;

use super::{
    conv_encoder::conv,
    init::Initializer,
    vit::{LAYER_NORM_EPSILON, VitBlock},
};

/// Side of the square of pixels that a token stands for.
const TOKEN_PIXELS: usize = 8;

/// Two convolutional levels and a level of tokens.
#[derive(Module, Debug)]
pub struct HybridEncoder {
    pub half: Conv2d,
    pub quarter: Conv2d,
    pub quarter_residual: Conv2d,
    pub tokens: Conv2d,
    pub pos_embed: Param<Tensor<3>>,
    pub blocks: Vec<VitBlock>,
    pub norm: LayerNorm,
}

impl HybridEncoder {
    /// Initial weights for square images of `image_size` pixels, a multiple of 8.
    pub fn new(config: &HybridConfig, image_size: usize, init: &mut Initializer) -> Self {
        let [c0, c1] = config.channels;
        let (width, tokens) = (config.embed_dim, (image_size / TOKEN_PIXELS).pow(2));
        Self {
            half: conv(3, c0, 2, init),
            quarter: conv(c0, c1, 2, init),
            quarter_residual: conv(c1, c1, 1, init),
            tokens: conv(c1, width, 2, init),
            pos_embed: init.normal([1, tokens, width], 0.02),
            blocks: (0..config.depth).map(|_| VitBlock::new(width, config.heads, init)).collect(),
            norm: init.layer_norm(width, LAYER_NORM_EPSILON),
        }
    }

    /// Normalised images `[B, 3, S, S]` to maps `[B, c, S/2, S/2]`, `[B, c, S/4, S/4]` and `[B, embed_dim, S/8, S/8]`.
    pub fn forward(&self, images: Tensor<4>) -> [Tensor<4>; 3] {
        let half = relu(self.half.forward(images));
        let x = relu(self.quarter.forward(half.clone()));
        let quarter = relu(self.quarter_residual.forward(x.clone())) + x;
        let x = self.tokens.forward(quarter.clone());
        let [batch, width, side, _] = x.dims();
        let x = x.reshape([batch, width, side * side]).swap_dims(1, 2) + self.pos_embed.val();
        let x = self.blocks.iter().fold(x, |x, block| block.forward(x));
        let eighth = self.norm.forward(x).swap_dims(1, 2).reshape([batch, width, side, side]);
        [half, quarter, eighth]
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Distribution};

    use super::*;

    /// A token sees the whole crop, and the tape's plain form gives what the fused form gives.
    #[test]
    fn maps_have_three_resolutions_and_tokens_see_everything() {
        let device = Device::default();
        let config =
            HybridConfig { channels: [4, 8], embed_dim: 128, depth: 2, heads: 2, ..HybridConfig::default() };
        let encoder = HybridEncoder::new(&config, 32, &mut Initializer::new(3, &device));
        let images = Tensor::<4>::random([2, 3, 32, 32], Distribution::Uniform(-1.0, 1.0), &device);
        let maps = encoder.forward(images.clone());
        assert_eq!(maps.each_ref().map(|m| m.dims()), [[2, 4, 16, 16], [2, 8, 8, 8], [2, 128, 4, 4]]);
        let taped = encoder.forward(images.clone().autodiff());
        for (fused, plain) in maps.iter().zip(taped) {
            let largest = (fused.clone() - plain.inner()).abs().max().into_scalar::<f32>();
            assert!(largest < 1e-4, "{largest}");
        }
        // Another corner of the first image: its tokens change everywhere, the second image's nowhere.
        let corner = Tensor::<4>::ones([1, 3, 4, 4], &device);
        let changed = encoder.forward(images.slice_assign([0..1, 0..3, 28..32, 28..32], corner));
        let difference = (changed[2].clone() - maps[2].clone()).abs().max_dim(1);
        let least = |i: usize| difference.clone().narrow(0, i, 1).min().into_scalar::<f32>();
        let most = |i: usize| difference.clone().narrow(0, i, 1).max().into_scalar::<f32>();
        assert!(least(0) > 1e-5 && most(1) == 0.0, "{} {}", least(0), most(1));
        let local = (changed[1].clone() - maps[1].clone()).abs().slice([0..1, 0..8, 0..5, 0..5]);
        assert_eq!(local.max().into_scalar::<f32>(), 0.0);
    }
}
