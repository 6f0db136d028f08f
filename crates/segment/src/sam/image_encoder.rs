//! Image encoder of Segment Anything: a vision transformer whose blocks attend within windows, all but a few, with
//! positions relative in rows and columns (Kirillov et al. 2023; ViTDet, Li et al. 2022). Field names are the published
//! ones.

use burn::{
    module::{Module, Param},
    nn::{LayerNorm, LayerNormConfig, Linear, conv::Conv2d},
    tensor::{Device, Int, Tensor, TensorData},
};
use unopose_nn::model::fused::{PositionBias, linear_gelu, linear_onto, positioned_self_attention};

use super::{
    grid::{from_windows, tokens_of, windows_of},
    layers::{MlpBlock, Neck, convolution, linear, neck, parameter, through_neck},
    sizes::VitSizes,
};

/// Added to the variance, as published.
const LAYER_NORM_EPSILON: f64 = 1e-6;

/// Patch projection.
#[derive(Module, Debug)]
pub struct PatchEmbed {
    pub proj: Conv2d,
}

/// The whole encoder.
#[derive(Module, Debug)]
pub struct ImageEncoderVit {
    pub patch_embed: PatchEmbed,
    /// `[1, side, side, C]`.
    pub pos_embed: Param<Tensor<4>>,
    pub blocks: Vec<Block>,
    pub neck: Neck,
}

/// Pre-norm transformer block.
#[derive(Module, Debug)]
pub struct Block {
    pub norm1: LayerNorm,
    pub attn: Attention,
    pub norm2: LayerNorm,
    pub mlp: MlpBlock,
    /// Side of the windows, tokens; `None`: all tokens attend to each other.
    window: Option<usize>,
}

/// Self attention with relative positions.
#[derive(Module, Debug)]
pub struct Attention {
    pub qkv: Linear,
    pub proj: Linear,
    /// Embeddings of the offsets -(side - 1) ..= side - 1 in rows, `[2 side - 1, d]`.
    pub rel_pos_h: Param<Tensor<2>>,
    /// The same for columns.
    pub rel_pos_w: Param<Tensor<2>>,
    heads: usize,
}

impl ImageEncoderVit {
    /// `out` channels of the image embedding, for images of `image_size` pixels.
    pub(super) fn new(sizes: &VitSizes, image_size: usize, out: usize, device: &Device) -> Self {
        let (width, patch) = (sizes.width, sizes.patch_size);
        let side = image_size / patch;
        let block = |window: &Option<usize>| Block::new(sizes, *window, side, device);
        Self {
            patch_embed: PatchEmbed { proj: convolution([3, width], patch, patch).init(device) },
            pos_embed: parameter([1, side, side, width], device),
            blocks: sizes.windows.iter().map(block).collect(),
            neck: neck(width, out, device),
        }
    }

    /// Normalised padded image `[1, 3, S, S]` to its embedding `[1, (S / patch)^2, D]`.
    pub fn forward(&self, image: Tensor<4>) -> Tensor<3> {
        let x = self.patches(image);
        let side = self.side();
        let x = self.blocks.iter().fold(x, |x, block| block.forward(x, side));
        through_neck(&self.neck, x, [side, side])
    }

    /// Patches per side of the image.
    pub fn side(&self) -> usize {
        self.pos_embed.dims()[1]
    }

    /// Embedded patches with their positions, `[1, side^2, C]`.
    pub fn patches(&self, image: Tensor<4>) -> Tensor<3> {
        let x = tokens_of(self.patch_embed.proj.forward(image));
        let positions = self.pos_embed.val().reshape(x.dims());
        x + positions
    }
}

impl Block {
    fn new(sizes: &VitSizes, window: Option<usize>, side: usize, device: &Device) -> Self {
        let (width, offsets) = (sizes.width, 2 * window.unwrap_or(side) - 1);
        let norm = || LayerNormConfig::new(width).with_epsilon(LAYER_NORM_EPSILON).init(device);
        Self {
            norm1: norm(),
            attn: Attention {
                qkv: linear(width, 3 * width, device),
                proj: linear(width, width, device),
                rel_pos_h: parameter([offsets, width / sizes.heads], device),
                rel_pos_w: parameter([offsets, width / sizes.heads], device),
                heads: sizes.heads,
            },
            norm2: norm(),
            mlp: MlpBlock {
                lin1: linear(width, sizes.mlp_width, device),
                lin2: linear(sizes.mlp_width, width, device),
            },
            window,
        }
    }

    /// Tokens `[1, side^2, C]`.
    pub fn forward(&self, x: Tensor<3>, side: usize) -> Tensor<3> {
        let normed = self.norm1.forward(x.clone());
        let grid = [side, side];
        let attended = match self.window {
            None => self.attn.forward(normed, side),
            // Padding comes after the norm: padded tokens are zeros, and they are attended to.
            Some(window) => {
                from_windows(self.attn.forward(windows_of(normed, grid, window), window), grid, window)
            }
        };
        let x = x + attended;
        let hidden = linear_gelu(self.norm2.forward(x.clone()), &self.mlp.lin1);
        let ones = Tensor::ones([x.dims()[2]], &x.device());
        linear_onto(x, hidden, &self.mlp.lin2, ones)
    }
}

impl Attention {
    /// Squares of `side x side` tokens, `[B, side^2, C]`.
    fn forward(&self, x: Tensor<3>, side: usize) -> Tensor<3> {
        let [rows, columns] =
            [&self.rel_pos_h, &self.rel_pos_w].map(|offsets| relative_positions(offsets.val(), side));
        let bias = PositionBias::Axes { rows: &rows, columns: &columns };
        self.proj.forward(positioned_self_attention(self.qkv.forward(x), self.heads, bias))
    }
}

/// Embedding of each query's offset from each key along an axis: `[2 side - 1, d]` to `[side, side, d]`.
fn relative_positions(offsets: Tensor<2>, side: usize) -> Tensor<3> {
    let d = offsets.dims()[1];
    let index = (0..side).flat_map(|query| (0..side).map(move |key| (query + side - 1 - key) as i32));
    let index = TensorData::new(index.collect::<Vec<_>>(), [side * side]);
    let index = Tensor::<1, Int>::from_data(index, &offsets.device());
    offsets.select(0, index).reshape([side, side, d])
}
