//! Layers that both image encoders and the decoder have. Parameters come into being when a file fills them.

use burn::{
    module::{Module, Param, ParamId},
    nn::{
        Initializer, Linear, LinearConfig, PaddingConfig2d,
        conv::{Conv2d, Conv2dConfig},
    },
    tensor::{
        Device, Tensor,
        module::{layer_norm, linear as linear_map},
    },
};
use unopose_nn::model::fused::layer_norm_gelu;

use super::grid::{image_of, tokens_of};

/// A parameter without values.
pub fn parameter<const D: usize>(shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
    let zeros = move |device: &Device, _: bool| Tensor::zeros(shape, device);
    Param::uninitialized(ParamId::new(), zeros, device.clone(), false, shape.into())
}

/// A linear layer without values.
pub fn linear(input: usize, output: usize, device: &Device) -> Linear {
    LinearConfig::new(input, output).with_initializer(Initializer::Zeros).init(device)
}

/// A square convolution without values, of whole patches (`stride` as long as the kernel) or padded so that stride 1 keeps
/// the size.
pub fn convolution(channels: [usize; 2], kernel: usize, stride: usize) -> Conv2dConfig {
    let pad = if stride == kernel { 0 } else { kernel / 2 };
    Conv2dConfig::new(channels, [kernel, kernel])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
        .with_initializer(Initializer::Zeros)
}

/// Two-layer perceptron.
#[derive(Module, Debug)]
pub struct MlpBlock {
    pub lin1: Linear,
    pub lin2: Linear,
}

/// A table of vectors.
#[derive(Module, Debug)]
pub struct Embedding {
    pub weight: Param<Tensor<2>>,
}

impl Embedding {
    pub fn new(rows: usize, width: usize, device: &Device) -> Self {
        Self { weight: parameter([rows, width], device) }
    }
}

/// Layer norm over the channels of each pixel.
#[derive(Module, Debug)]
pub struct LayerNorm2d {
    pub weight: Param<Tensor<1>>,
    pub bias: Param<Tensor<1>>,
}

impl LayerNorm2d {
    const EPSILON: f64 = 1e-6;

    pub fn new(width: usize, device: &Device) -> Self {
        Self { weight: parameter([width], device), bias: parameter([width], device) }
    }

    /// Pixels `[B, N, C]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        layer_norm(x, self.weight.val(), Some(self.bias.val()), Self::EPSILON)
    }

    /// GELU of [`Self::forward`].
    pub fn gelu(&self, x: Tensor<3>) -> Tensor<3> {
        layer_norm_gelu(x, self.weight.val(), self.bias.val(), Self::EPSILON)
    }
}

/// End of the image encoders: channels to those of the decoder, each pixel with its neighbours.
pub type Neck = (Conv2d, LayerNorm2d, Conv2d, LayerNorm2d);

/// A neck without values from `width` to `out` channels.
pub fn neck(width: usize, out: usize, device: &Device) -> Neck {
    let conv =
        |input: usize, kernel: usize| convolution([input, out], kernel, 1).with_bias(false).init(device);
    (conv(width, 1), LayerNorm2d::new(out, device), conv(out, 3), LayerNorm2d::new(out, device))
}

/// Tokens `[1, h w, C]` to the image embedding `[1, h w, D]`.
pub fn through_neck(neck: &Neck, tokens: Tensor<3>, grid: [usize; 2]) -> Tensor<3> {
    let (narrow, norm, smooth, last) = neck;
    let [out, input, ..] = narrow.weight.dims();
    let weight = narrow.weight.val().reshape([out, input]).transpose();
    let x = norm.forward(linear_map(tokens, weight, None));
    last.forward(tokens_of(smooth.forward(image_of(x, grid))))
}
