//! Multi-head attention of the matching transformers: plain, and with the relative-position term of GeoTransformer.

use burn::{module::Module, nn::Linear, tensor::Tensor};

use super::{
    fused::{AttentionMaps, relative_scores, softmax_attention, split_heads},
    init::Initializer,
};

/// Projections shared by both kinds; `proj_p` is present for relative positions.
#[derive(Module, Debug)]
pub struct MultiHeadAttention {
    /// Queries `[C, C]`.
    pub proj_q: Linear,
    /// Keys `[C, C]`.
    pub proj_k: Linear,
    /// Values `[C, C]`.
    pub proj_v: Linear,
    /// Structure embedding `[C, C]`.
    pub proj_p: Option<Linear>,
    heads: usize,
}

impl MultiHeadAttention {
    /// `relative` attention reads a structure embedding.
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

    /// Queries `[B, N, C]` attend to `memory` `[B, M, C]`; `embedding` `[B, N, M, C]` is the structure embedding.
    ///
    /// Score = (q . k + q . (W_p e + b_p)) / sqrt(C / H). The query is projected by `W_p^T` instead of the embedding
    /// by `W_p`, which turns an `N x M x C x C` product into an `N x C x C` one.
    pub fn forward(&self, queries: Tensor<3>, memory: Tensor<3>, embedding: Option<Tensor<4>>) -> Tensor<3> {
        let [batch, _, width] = queries.dims();
        let head_width = width / self.heads;
        let queries = self.proj_q.forward(queries) * (head_width as f64).powf(-0.5);
        let keys = self.proj_k.forward(memory.clone());
        let values = self.proj_v.forward(memory);
        let position = self.proj_p.as_ref().zip(embedding).map(|(proj_p, embedding)| {
            let q = split_heads(queries.clone(), self.heads); // [B, H, N, d]
            // weight [C_e, C_out] -> per head [H, d, C_e]
            let weight = proj_p
                .weight
                .val()
                .reshape([width, self.heads, head_width])
                .permute([1, 2, 0])
                .unsqueeze::<4>();
            let position = relative_scores(q.clone().matmul(weight), embedding); // [B, H, N, M]
            match &proj_p.bias {
                Some(bias) => {
                    let bias = bias.val().reshape([1, self.heads, head_width, 1]);
                    position + q.matmul(bias.expand([batch, self.heads, head_width, 1])) // [B, H, N, 1]
                }
                None => position,
            }
        });
        softmax_attention(queries, keys, values, position, self.heads)
    }
}
