//! Small trainable colour encoder: convolutions at half, quarter and eighth resolution, read out at the points only.

use burn::{
    module::Module,
    nn::{
        PaddingConfig2d,
        conv::{Conv2d, Conv2dConfig},
    },
    tensor::{Tensor, activation::relu},
};

use super::init::Initializer;

/// Three-level convolutional encoder with one residual convolution on each of the two coarser levels.
#[derive(Module, Debug)]
pub struct ConvEncoder {
    pub half: Conv2d,
    pub quarter: Conv2d,
    pub quarter_residual: Conv2d,
    pub eighth: Conv2d,
    pub eighth_residual: Conv2d,
}

impl ConvEncoder {
    /// `channels` at half, quarter and eighth resolution.
    pub fn new(channels: [usize; 3], init: &mut Initializer) -> Self {
        let [c0, c1, c2] = channels;
        Self {
            half: conv(3, c0, 2, init),
            quarter: conv(c0, c1, 2, init),
            quarter_residual: conv(c1, c1, 1, init),
            eighth: conv(c1, c2, 2, init),
            eighth_residual: conv(c2, c2, 1, init),
        }
    }

    /// Normalised images `[B, 3, S, S]` (`S` a multiple of 8) to maps `[B, c, S/2, S/2]`, `[B, c, S/4, S/4]` and
    /// `[B, c, S/8, S/8]`.
    pub fn forward(&self, images: Tensor<4>) -> [Tensor<4>; 3] {
        let half = relu(self.half.forward(images));
        let x = relu(self.quarter.forward(half.clone()));
        let quarter = relu(self.quarter_residual.forward(x.clone())) + x;
        let x = relu(self.eighth.forward(quarter.clone()));
        let eighth = relu(self.eighth_residual.forward(x.clone())) + x;
        [half, quarter, eighth]
    }
}

/// 3x3 convolution, Kaiming normal.
pub(super) fn conv(input: usize, output: usize, stride: usize, init: &mut Initializer) -> Conv2d {
    let mut conv = Conv2dConfig::new([input, output], [3, 3])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(1, 1, 1, 1))
        .init(init.device());
    conv.weight = init.normal([output, input, 3, 3], (2.0 / (input * 9) as f64).sqrt());
    conv.bias = Some(init.constant([output], 0.0));
    conv
}
