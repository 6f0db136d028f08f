//! Multi-head attention of the matching transformers: plain, and with the relative-position term of GeoTransformer.

use burn::{
    module::Module,
    nn::Linear,
    tensor::{Tensor, activation::softmax},
};

use super::{
    fused::{AttentionMaps, relative_scores},
    init::Initializer,
};

/// Projections shared by both kinds; `proj_p` is present for relative positions.
#[derive(Module, Debug)]
pub struct MultiHeadAttention {
    pub proj_q: Linear,
    pub proj_k: Linear,
    pub proj_v: Linear,
    pub proj_p: Option<Linear>,
    heads: usize,
}

impl MultiHeadAttention {
    pub fn new(width: usize, heads: usize, relative: bool, init: &mut Initializer) -> Self {
        Self {
            proj_q: init.linear(width, width),
            proj_k: init.linear(width, width),
            proj_v: init.linear(width, width),
            proj_p: relative.then(|| init.linear(width, width)),
            heads,
        }
    }

    pub(super) fn maps(&self) -> AttentionMaps<'_> {
        AttentionMaps {
            query: &self.proj_q,
            key: &self.proj_k,
            value: &self.proj_v,
            relative: self.proj_p.as_ref(),
            heads: self.heads,
        }
    }

    /// `[B, N, C] -> [B, H, N, C / H]`.
    fn split(&self, x: Tensor<3>) -> Tensor<4> {
        let [batch, n, width] = x.dims();
        x.reshape([batch, n, self.heads, width / self.heads]).swap_dims(1, 2)
    }

    /// Queries `[B, N, C]` attend to `memory` `[B, M, C]`; `embedding` `[B, N, M, C]` is the structure embedding.
    ///
    /// Score = (q . k + q . (W_p e + b_p)) / sqrt(C / H). The query is projected by `W_p^T` instead of the embedding
    /// by `W_p`, which turns an `N x M x C x C` product into an `N x C x C` one.
    pub fn forward(&self, queries: Tensor<3>, memory: Tensor<3>, embedding: Option<Tensor<4>>) -> Tensor<3> {
        let [batch, n, width] = queries.dims();
        let head_width = width / self.heads;
        let q = self.split(self.proj_q.forward(queries)) * (head_width as f64).powf(-0.5); // [B, H, N, d]
        let k = self.split(self.proj_k.forward(memory.clone()));
        let v = self.split(self.proj_v.forward(memory));
        let mut scores = q.clone().matmul(k.swap_dims(2, 3)); // [B, H, N, M]
        if let (Some(proj_p), Some(embedding)) = (&self.proj_p, embedding) {
            // weight [C_e, C_out] -> per head [H, d, C_e]
            let weight = proj_p
                .weight
                .val()
                .reshape([width, self.heads, head_width])
                .permute([1, 2, 0])
                .unsqueeze::<4>();
            let projected = q.clone().matmul(weight); // [B, H, N, C]
            let position = relative_scores(projected, embedding); // [B, H, N, M]
            scores = scores + position;
            if let Some(bias) = &proj_p.bias {
                let bias = bias.val().reshape([1, self.heads, head_width, 1]);
                scores = scores + q.matmul(bias.expand([batch, self.heads, head_width, 1])); // [B, H, N, 1]
            }
        }
        softmax(scores, 3).matmul(v).swap_dims(1, 2).reshape([batch, n, width])
    }
}
