//! Post-norm transformer layers and the `["self", "cross"]` block of GeoTransformer. Field names are the release's.

use burn::{
    module::Module,
    nn::{LayerNorm, Linear},
    tensor::{Tensor, activation::relu},
};

use super::{
    attention::MultiHeadAttention,
    fused::{TokenMaps, attention_layer},
    init::Initializer,
};

pub(super) const LAYER_NORM_EPSILON: f64 = 1e-5;

/// Attention, output projection, residual, norm.
#[derive(Module, Debug)]
pub struct AttentionLayer {
    pub attention: MultiHeadAttention,
    pub linear: Linear,
    pub norm: LayerNorm,
}

/// Feed-forward part: `norm(x + squeeze(relu(expand(x))))`, twice the width inside.
#[derive(Module, Debug)]
pub struct AttentionOutput {
    pub expand: Linear,
    pub squeeze: Linear,
    pub norm: LayerNorm,
}

/// Attention layer and feed-forward part.
#[derive(Module, Debug)]
pub struct TransformerLayer {
    /// Attention with its projection and norm.
    pub attention: AttentionLayer,
    /// The feed-forward part.
    pub output: AttentionOutput,
}

/// Self attention with structure embedding on each cloud, then sequential cross attention.
#[derive(Module, Debug)]
pub struct GeometricTransformer {
    /// `[self, cross]`.
    pub layers: Vec<TransformerLayer>,
}

impl AttentionOutput {
    /// Initial weights; `relative` attention reads a structure embedding.
    pub fn new(width: usize, init: &mut Initializer) -> Self {
        Self {
            expand: init.linear(width, 2 * width),
            squeeze: init.linear(2 * width, width),
            norm: init.layer_norm(width, LAYER_NORM_EPSILON),
        }
    }

    /// With the attention's output projection and norm in front.
    pub(super) fn maps_after<'a>(&'a self, linear: &'a Linear, norm: &'a LayerNorm) -> TokenMaps<'a> {
        TokenMaps {
            linear,
            norm,
            expand: &self.expand,
            squeeze: &self.squeeze,
            output_norm: &self.norm,
            epsilon: LAYER_NORM_EPSILON,
        }
    }

    /// `[B, N, C]` in and out.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let hidden = self.squeeze.forward(relu(self.expand.forward(x.clone())));
        self.norm.forward(hidden + x)
    }
}

impl TransformerLayer {
    /// Initial weights.
    pub fn new(width: usize, heads: usize, relative: bool, init: &mut Initializer) -> Self {
        Self {
            attention: AttentionLayer {
                attention: MultiHeadAttention::new(width, heads, relative, init),
                linear: init.linear(width, width),
                norm: init.layer_norm(width, LAYER_NORM_EPSILON),
            },
            output: AttentionOutput::new(width, init),
        }
    }

    /// `x` `[B, N, C]` attends to `memory` `[B, M, C]`.
    pub fn forward(&self, x: Tensor<3>, memory: Tensor<3>, embedding: Option<Tensor<4>>) -> Tensor<3> {
        let AttentionLayer { attention, linear, norm } = &self.attention;
        let tail = self.output.maps_after(linear, norm);
        if let Some(y) = attention_layer(&attention.maps(), &tail, &x, &memory, embedding.as_ref()) {
            return y;
        }
        let attended = self.attention.attention.forward(x.clone(), memory, embedding);
        let attended = self.attention.linear.forward(attended);
        let x = self.attention.norm.forward(attended + x);
        self.output.forward(x)
    }
}

impl GeometricTransformer {
    /// Initial weights of both layers.
    pub fn new(width: usize, heads: usize, init: &mut Initializer) -> Self {
        let layers = [true, false].map(|relative| TransformerLayer::new(width, heads, relative, init));
        Self { layers: layers.into() }
    }

    /// Query and reference features `[B, M, C]` with their embeddings `[B, M, M, C]`; the reference attends to the
    /// already updated query.
    pub fn forward(
        &self,
        query: Tensor<3>,
        query_embedding: Tensor<4>,
        reference: Tensor<3>,
        reference_embedding: Tensor<4>,
    ) -> (Tensor<3>, Tensor<3>) {
        let query = self.self_attention(query, query_embedding);
        let reference = self.self_attention(reference, reference_embedding);
        self.cross_attention(query, reference)
    }

    /// The first layer: a cloud attends to itself, with its structure embedding.
    pub fn self_attention(&self, x: Tensor<3>, embedding: Tensor<4>) -> Tensor<3> {
        self.layers[0].forward(x.clone(), x, Some(embedding))
    }

    /// The second layer: the clouds attend to each other, the reference to the already updated query.
    pub fn cross_attention(&self, query: Tensor<3>, reference: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let query = self.layers[1].forward(query, reference.clone(), None);
        let reference = self.layers[1].forward(reference, query.clone(), None);
        (query, reference)
    }
}
