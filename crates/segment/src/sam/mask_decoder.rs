//! Mask decoder: prompts and image to masks and the overlap that each is predicted to have with the object. Field names
//! are the published ones.

use std::ops::Range;

use burn::{
    module::{Module, Param},
    nn::{
        Gelu, Initializer, Linear,
        conv::{ConvTranspose2d, ConvTranspose2dConfig},
    },
    tensor::{Device, Tensor, activation::relu},
};
use unopose_nn::model::fused::linear_gelu;

use super::{
    layers::{Embedding, LayerNorm2d, linear},
    sizes::DecoderSizes,
    two_way::TwoWayTransformer,
};

/// Layers of the heads for overlap and masks.
const LAYERS: usize = 3;
/// An image token becomes a square of this many mask pixels.
const PIXELS: usize = 4;

/// The mask decoder.
#[derive(Module, Debug)]
pub struct MaskDecoder {
    pub transformer: TwoWayTransformer,
    pub iou_token: Embedding,
    pub mask_tokens: Embedding,
    pub output_upscaling: (ConvTranspose2d, LayerNorm2d, Gelu, ConvTranspose2d),
    pub output_hypernetworks_mlps: Vec<Mlp>,
    pub iou_prediction_head: Mlp,
}

/// Linear layers with ReLU between them.
#[derive(Module, Debug)]
pub struct Mlp {
    pub layers: Vec<Linear>,
}

/// What the decoder knows about P prompts.
pub struct Decoded {
    /// Tokens of the masks, `[P, M, D]`.
    tokens: Tensor<3>,
    /// The image as each prompt sees it, `[P, T, D]`.
    image: Tensor<3>,
    /// Predicted overlap of each mask with what the prompt means, `[P, M]`.
    pub iou: Tensor<2>,
}

impl MaskDecoder {
    pub(super) fn new(sizes: &DecoderSizes, device: &Device) -> Self {
        let width = sizes.width;
        let twice = |input: usize, output: usize| {
            let config = ConvTranspose2dConfig::new([input, output], [2, 2]).with_stride([2, 2]);
            config.with_initializer(Initializer::Zeros).init(device)
        };
        let (half, pixel) = (width / 4, width / 8);
        Self {
            transformer: TwoWayTransformer::new(sizes, device),
            iou_token: Embedding::new(1, width, device),
            mask_tokens: Embedding::new(sizes.mask_tokens, width, device),
            output_upscaling: (
                twice(width, half),
                LayerNorm2d::new(half, device),
                Gelu::new(),
                twice(half, pixel),
            ),
            output_hypernetworks_mlps: (0..sizes.mask_tokens)
                .map(|_| Mlp::new(width, width, pixel, device))
                .collect(),
            iou_prediction_head: Mlp::new(width, sizes.iou_width, sizes.mask_tokens, device),
        }
    }

    /// Image embedding `[1, T, D]` (with what stands for no mask), positions of its patches `[1, T, D]`, and the tokens of
    /// P prompts `[P, N, D]`.
    pub fn forward(&self, image: Tensor<3>, positions: Tensor<3>, prompts: Tensor<3>) -> Decoded {
        let [count, _, width] = prompts.dims();
        let own = Tensor::cat(vec![self.iou_token.weight.val(), self.mask_tokens.weight.val()], 0);
        let masks = self.mask_tokens.weight.dims()[0];
        let own = own.unsqueeze::<3>().expand([count, 1 + masks, width]);
        let tokens = Tensor::cat(vec![own, prompts], 1);
        let (tokens, image) = self.transformer.forward(tokens, image, positions);
        let iou = self.iou_prediction_head.forward(tokens.clone().narrow(1, 0, 1));
        Decoded { tokens: tokens.narrow(1, 1, masks), image, iou: iou.reshape([count, masks]) }
    }

    /// Logits of some masks of a prompt on the image's grid of `[h, w]` patches, `[masks, 4 h, 4 w]`; 0 and less is
    /// outside.
    pub fn masks(
        &self,
        decoded: &Decoded,
        prompt: usize,
        masks: Range<usize>,
        grid: [usize; 2],
    ) -> Tensor<3> {
        let [h, w] = grid;
        let pixels = self.upscaled(decoded.image.clone().narrow(0, prompt, 1)); // [1, T 16, D / 8]
        let count = masks.len();
        let tokens = decoded.tokens.clone().narrow(0, prompt, 1);
        let weights =
            masks.map(|mask| self.output_hypernetworks_mlps[mask].forward(tokens.clone().narrow(1, mask, 1)));
        let weights = Tensor::cat(weights.collect(), 1); // [1, M, D / 8]
        // Rows of the last product run over patch, then the pixel in it by the first and by the second doubling.
        let logits: Tensor<7> = weights.matmul(pixels.swap_dims(1, 2)).reshape([count, h, w, 2, 2, 2, 2]);
        logits.permute([0, 1, 3, 5, 2, 4, 6]).reshape([count, PIXELS * h, PIXELS * w])
    }

    /// Image tokens `[1, T, D]` to pixels, 16 for each token: `[1, 16 T, D / 8]`. A transposed convolution whose stride is
    /// its kernel maps each pixel alone.
    fn upscaled(&self, image: Tensor<3>) -> Tensor<3> {
        let (first, norm, _, second) = &self.output_upscaling;
        let four = |x: Tensor<3>, channels: usize| {
            let [_, count, _] = x.dims();
            x.reshape([1, 4 * count, channels])
        };
        let x = four(pixels_of(first).forward(image), first.channels[1]);
        four(linear_gelu(norm.gelu(x), &pixels_of(second)), second.channels[1])
    }
}

/// The linear map of a pixel to the four that a transposed convolution makes of it, `[D, 4 C]`.
fn pixels_of(doubling: &ConvTranspose2d) -> Linear {
    let [input, output, h, w] = doubling.weight.dims();
    let weight = doubling.weight.val().permute([0, 2, 3, 1]).reshape([input, h * w * output]);
    let bias = doubling.bias.as_ref().map(|bias| Param::from_tensor(bias.val().repeat_dim(0, h * w)));
    Linear { weight: Param::from_tensor(weight), bias }
}

impl Mlp {
    fn new(input: usize, hidden: usize, output: usize, device: &Device) -> Self {
        let width = |layer: usize, end: usize, outer: usize| if layer == end { outer } else { hidden };
        let layer = |i: usize| linear(width(i, 0, input), width(i + 1, LAYERS, output), device);
        Self { layers: (0..LAYERS).map(layer).collect() }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let last = self.layers.len() - 1;
        self.layers.iter().enumerate().fold(x, |x, (index, layer)| {
            let x = layer.forward(x);
            if index < last { relu(x) } else { x }
        })
    }
}
