//! Whole layers without gradients, each in as few passes as its dependencies allow. Their plain forms are the layers' own
//! `forward`s, which run when a function here answers `None`.

use burn::{
    nn::{LayerNorm, Linear},
    tensor::Tensor,
};

use super::kernels;

/// What a transformer layer does with what its tokens read: output projection, residual, norm, then the feed-forward part
/// `norm(x + squeeze(relu(expand(x))))`.
pub struct TokenMaps<'a> {
    /// Projection of what was read.
    pub linear: &'a Linear,
    /// Norm after the residual.
    pub norm: &'a LayerNorm,
    /// First map of the feed-forward part.
    pub expand: &'a Linear,
    /// Second map of the feed-forward part.
    pub squeeze: &'a Linear,
    /// Norm after the feed-forward part's residual.
    pub output_norm: &'a LayerNorm,
    /// Of both norms, which keep it to themselves.
    pub epsilon: f64,
}

/// Projections of softmax attention; `relative` is that of the structure embedding.
pub struct AttentionMaps<'a> {
    /// Queries.
    pub query: &'a Linear,
    /// Keys.
    pub key: &'a Linear,
    /// Values.
    pub value: &'a Linear,
    /// Structure embedding.
    pub relative: Option<&'a Linear>,
    /// Number of heads, which divides the width.
    pub heads: usize,
}

/// Projections of focused linear attention with exponent 3.
pub struct FocusedMaps<'a> {
    /// Queries.
    pub query: &'a Linear,
    /// Keys.
    pub key: &'a Linear,
    /// Values.
    pub value: &'a Linear,
    /// Positive, `[1, 1, C]`.
    pub scale: &'a Tensor<3>,
    /// Number of heads, which divides the width.
    pub heads: usize,
    /// Added to rectified features.
    pub epsilon: f64,
}

/// Parameters of a vision transformer's block.
pub struct VisionMaps<'a> {
    /// Norm before the attention.
    pub norm1: &'a LayerNorm,
    /// Query, key and value side by side.
    pub qkv: &'a Linear,
    /// Projection of what was read.
    pub proj: &'a Linear,
    /// Norm before the perceptron.
    pub norm2: &'a LayerNorm,
    /// First map of the perceptron.
    pub fc1: &'a Linear,
    /// Second map of the perceptron.
    pub fc2: &'a Linear,
    /// What the attention's and the perceptron's outputs are scaled by, `[C]`.
    pub scales: [Tensor<1>; 2],
    /// Number of heads, which divides the width.
    pub heads: usize,
    /// Of both norms, which keep it to themselves.
    pub epsilon: f64,
}

/// A block of a vision transformer, `[B, T, C]` in and out. `None` where it can't be fused: the block's own form is the
/// plain one.
pub fn vision_block(maps: &VisionMaps, x: &Tensor<3>) -> Option<Tensor<3>> {
    kernels::vision_block(maps, x)
}

/// [`vision_block`] for some of the tokens `[B * T]`, image by image, in `[n, C]`.
pub fn vision_block_at(maps: &VisionMaps, x: &Tensor<3>, wanted: &[usize]) -> Option<Tensor<2>> {
    kernels::vision_block_at(maps, x, wanted)
}

/// A layer in which tokens `[B, N, C]` attend to `memory` `[B, M, C]`, with the structure embedding `[B, N, M, C]` where
/// the attention has relative positions. `None` where it can't be fused: the layer's own form is the plain one.
pub fn attention_layer(
    maps: &AttentionMaps,
    tail: &TokenMaps,
    x: &Tensor<3>,
    memory: &Tensor<3>,
    embedding: Option<&Tensor<4>>,
) -> Option<Tensor<3>> {
    kernels::attention_layer(maps, tail, x, memory, embedding)
}

/// A layer in which the dense tokens `[B, 1 + N, C]` attend to the sparse ones `[B, 1 + M, C]`, without the background
/// tokens in front; the sparse background replaces the dense one. `None` where it can't be fused.
pub fn dense_layer(
    maps: &FocusedMaps,
    tail: &TokenMaps,
    dense: &Tensor<3>,
    sparse: &Tensor<3>,
) -> Option<Tensor<3>> {
    kernels::dense_layer(maps, tail, dense, sparse)
}
