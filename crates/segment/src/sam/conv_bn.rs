//! Convolution with batch norm by the statistics of training, folded into the convolution.

use burn::{
    module::{Module, Param},
    nn::conv::{Conv2d, Conv2dConfig},
    tensor::{Device, Tensor},
};

use super::layers::parameter;

/// Added to the variance, as published.
const EPSILON: f64 = 1e-5;

/// Convolution without bias and the norm of its channels.
#[derive(Module, Debug)]
pub struct ConvBn {
    pub c: Conv2d,
    pub bn: BatchNorm2d,
}

/// Scale, shift and statistics per channel.
#[derive(Module, Debug)]
pub struct BatchNorm2d {
    pub weight: Param<Tensor<1>>,
    pub bias: Param<Tensor<1>>,
    pub running_mean: Param<Tensor<1>>,
    pub running_var: Param<Tensor<1>>,
}

impl ConvBn {
    /// Without values; `convolution` gets no bias.
    pub fn new(convolution: Conv2dConfig, device: &Device) -> Self {
        let c = convolution.with_bias(false).init(device);
        let channels = c.weight.lazy_shape()[0];
        let channel = || parameter([channels], device);
        let bn = BatchNorm2d {
            weight: channel(),
            bias: channel(),
            running_mean: channel(),
            running_var: channel(),
        };
        Self { c, bn }
    }

    /// `[B, C_in, h, w]` to `[B, C, h', w']`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let bn = &self.bn;
        let scale = bn.weight.val() / (bn.running_var.val() + EPSILON).sqrt();
        let shift = bn.bias.val() - bn.running_mean.val() * scale.clone();
        let channels = scale.dims()[0];
        let weight = self.c.weight.val() * scale.reshape([channels, 1, 1, 1]);
        let folded = Conv2d {
            weight: Param::from_tensor(weight),
            bias: Some(Param::from_tensor(shift)),
            ..self.c.clone()
        };
        folded.forward(x)
    }
}
