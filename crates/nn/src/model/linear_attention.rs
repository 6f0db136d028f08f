//! Focused linear attention from the dense to the sparse tokens (SAM-6D, after Han et al. 2023).

use burn::{
    module::{Module, Param},
    nn::{LayerNorm, Linear},
    tensor::{
        Tensor,
        activation::{relu, softplus},
    },
};

use super::{
    fused::{FocusedMaps, dense_layer, focus_cubed},
    init::Initializer,
    transformer::{AttentionOutput, LAYER_NORM_EPSILON},
};

/// Projections and the learned scale of the feature map.
#[derive(Module, Debug)]
pub struct FocusedLinearAttention {
    pub proj_q: Linear,
    pub proj_k: Linear,
    pub proj_v: Linear,
    /// `[1, 1, C]`, through softplus.
    pub scale: Param<Tensor<3>>,
    heads: usize,
    focusing_factor: f64,
}

/// Linear attention with output projection, residual, norm.
#[derive(Module, Debug)]
pub struct LinearAttentionLayer {
    pub attention: FocusedLinearAttention,
    pub linear: Linear,
    pub norm: LayerNorm,
}

/// Linear attention layer and feed-forward part.
#[derive(Module, Debug)]
pub struct LinearTransformerLayer {
    /// Attention with its projection and norm.
    pub attention: LinearAttentionLayer,
    /// The feed-forward part.
    pub output: AttentionOutput,
}

const EPSILON: f64 = 1e-6;

impl FocusedLinearAttention {
    /// Feature map: `(relu(x) + eps) / softplus(scale)`, raised elementwise to the focusing factor, rescaled to its
    /// old norm over all channels.
    fn focus(&self, x: Tensor<3>) -> Tensor<3> {
        let scale = softplus(self.scale.val(), 1.0);
        if self.focusing_factor == 3.0 {
            return focus_cubed(x, scale, EPSILON);
        }
        let x = (relu(x) + EPSILON) / scale;
        let norm = |x: &Tensor<3>| (x.clone() * x.clone()).sum_dim(2).sqrt(); // [B, N, 1]
        let before = norm(&x);
        let focused = x.powf_scalar(self.focusing_factor);
        let ratio = before / norm(&focused);
        focused * ratio
    }

    /// `[B, N, C]` attends to `[B, M, C]`.
    fn forward(&self, queries: Tensor<3>, memory: Tensor<3>) -> Tensor<3> {
        let [batch, n, width] = queries.dims();
        let split = |x: Tensor<3>| {
            let tokens = x.dims()[1];
            x.reshape([batch, tokens, self.heads, width / self.heads]).swap_dims(1, 2) // [B, H, tokens, d]
        };
        let q = split(self.focus(self.proj_q.forward(queries)));
        let k = split(self.focus(self.proj_k.forward(memory.clone())));
        let v = split(self.proj_v.forward(memory));
        let normaliser = q.clone().matmul(k.clone().sum_dim(2).swap_dims(2, 3)) + EPSILON; // [B, H, N, 1]
        let context = k.swap_dims(2, 3).matmul(v); // [B, H, d, d]
        (q.matmul(context) / normaliser).swap_dims(1, 2).reshape([batch, n, width])
    }
}

impl LinearTransformerLayer {
    /// Initial weights; `focusing_factor` is the exponent of the focused features.
    pub fn new(width: usize, heads: usize, focusing_factor: f32, init: &mut Initializer) -> Self {
        Self {
            attention: LinearAttentionLayer {
                attention: FocusedLinearAttention {
                    proj_q: init.linear(width, width),
                    proj_k: init.linear(width, width),
                    proj_v: init.linear(width, width),
                    scale: init.constant([1, 1, width], 0.0),
                    heads,
                    focusing_factor: focusing_factor as f64,
                },
                linear: init.linear(width, width),
                norm: init.layer_norm(width, LAYER_NORM_EPSILON),
            },
            output: AttentionOutput::new(width, init),
        }
    }

    /// Dense tokens `[B, 1 + N, C]` attend to sparse ones `[B, 1 + M, C]`, background excluded on both sides; the sparse
    /// background token replaces the dense one.
    pub fn attend(&self, dense: Tensor<3>, sparse: Tensor<3>) -> Tensor<3> {
        if let Some(y) = self.fused(&dense, &sparse) {
            return y;
        }
        let ([batch, tokens, _], [_, sparse_tokens, _]) = (dense.dims(), sparse.dims());
        let background = sparse.clone().slice([0..batch, 0..1]);
        let memory = sparse.slice([0..batch, 1..sparse_tokens]);
        let points = self.forward(dense.slice([0..batch, 1..tokens]), memory);
        Tensor::cat(vec![background, points], 1)
    }

    fn fused(&self, dense: &Tensor<3>, sparse: &Tensor<3>) -> Option<Tensor<3>> {
        let LinearAttentionLayer { attention, linear, norm } = &self.attention;
        if attention.focusing_factor != 3.0 {
            return None;
        }
        let maps = FocusedMaps {
            query: &attention.proj_q,
            key: &attention.proj_k,
            value: &attention.proj_v,
            scale: &softplus(attention.scale.val(), 1.0),
            heads: attention.heads,
            epsilon: EPSILON,
        };
        dense_layer(&maps, &self.output.maps_after(linear, norm), dense, sparse)
    }

    /// `x` `[B, N, C]` attends to `memory` `[B, M, C]`.
    pub fn forward(&self, x: Tensor<3>, memory: Tensor<3>) -> Tensor<3> {
        let attended = self.attention.attention.forward(x.clone(), memory);
        let attended = self.attention.linear.forward(attended);
        let x = self.attention.norm.forward(attended + x);
        self.output.forward(x)
    }
}
