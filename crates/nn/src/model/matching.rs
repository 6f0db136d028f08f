//! What the coarse and the fine stage share: projections, background token, overlap heads and similarity.

use burn::{
    module::Param,
    nn::Linear,
    tensor::{
        Tensor,
        activation::{sigmoid, softmax},
    },
};
use unopose_core::config::{MatchingConfig, OverlapMode};

use super::{
    fused::cosines,
    init::Initializer,
    precision::{like, single},
};

/// Result of one block of one stage.
#[derive(Clone, Debug)]
pub struct BlockOutput {
    /// Cosine similarity / temperature, background at index 0: `[B, 1 + N, 1 + N]`.
    pub similarity: Tensor<3>,
    /// Raw overlap scores (logits) of the query and reference points, `[B, N]`; `None` without overlap heads.
    pub overlap: Option<[Tensor<2>; 2]>,
    /// Raw overlap scores of the two background tokens, `[B, 1]`, where they weigh features (the paper's form).
    pub background_overlap: Option<[Tensor<2>; 2]>,
}

impl BlockOutput {
    /// Cosines of features `[B, N, C]` and `[B, M, C]` over a temperature: `[B, N, M]`.
    pub fn cosine_similarity(query: Tensor<3>, reference: Tensor<3>, temperature: f64) -> Tensor<3> {
        // The factor on the smaller operand saves a pass over [N, M].
        (normalize(query) / temperature).matmul(normalize(reference).swap_dims(1, 2))
    }

    /// Overlap probabilities of the query and reference points `[B, N]`; 1 without overlap heads.
    pub fn overlap_probability(&self) -> [Tensor<2>; 2] {
        match &self.overlap {
            Some(logits) => logits.clone().map(sigmoid),
            None => {
                let [batch, n, m] = self.similarity.dims();
                let device = self.similarity.device();
                [Tensor::ones([batch, n - 1], &device), Tensor::ones([batch, m - 1], &device)]
            }
        }
    }

    /// Saliency logits of the query and reference points: the other cloud's raw overlap scores, averaged with the
    /// softmax of the similarity without background, `[B, N]` each.
    pub fn saliency(&self) -> Option<[Tensor<2>; 2]> {
        let [query, reference] = self.overlap.clone()?;
        let [batch, n, m] = self.similarity.dims();
        let inner = self.similarity.clone().slice([0..batch, 1..n, 1..m]);
        let of_query = softmax(inner.clone(), 2).matmul(reference.unsqueeze_dim(2)).squeeze_dim::<2>(2);
        let of_reference =
            softmax(inner.swap_dims(1, 2), 2).matmul(query.unsqueeze_dim(2)).squeeze_dim::<2>(2);
        Some([of_query, of_reference])
    }
}

/// Parameters that both stages have; the stages hold them under the release's flat names and lend them here.
pub struct MatchingHead<'a> {
    pub in_proj: &'a Linear,
    pub out_proj: &'a Linear,
    /// `[1, 1, C]`.
    pub bg_token: &'a Param<Tensor<3>>,
    /// One `Linear(C, 1)` per block.
    pub score_heads: Option<&'a [Linear]>,
    pub temperature: f64,
    /// Scale the features by the overlap before the similarity (paper) instead of the assignment (release).
    pub overlap_features: bool,
}

/// Freshly initialised parameters of a head.
pub struct HeadParameters {
    pub in_proj: Linear,
    pub out_proj: Linear,
    pub bg_token: Param<Tensor<3>>,
    pub score_heads: Option<Vec<Linear>>,
}

impl HeadParameters {
    pub fn new(
        input_dim: usize,
        config: &MatchingConfig,
        overlap: OverlapMode,
        init: &mut Initializer,
    ) -> Self {
        Self {
            in_proj: init.linear(input_dim, config.hidden_dim),
            out_proj: init.linear(config.hidden_dim, config.out_dim),
            bg_token: init.normal([1, 1, config.hidden_dim], 0.02),
            score_heads: (overlap != OverlapMode::Off)
                .then(|| (0..config.blocks).map(|_| init.linear(config.hidden_dim, 1)).collect()),
        }
    }
}

impl MatchingHead<'_> {
    /// Point features `[B, N, input]` to tokens with the background in front `[B, 1 + N, C]`; `extra` is added to the
    /// projected points.
    pub fn tokens(&self, features: Tensor<3>, extra: Option<Tensor<3>>) -> Tensor<3> {
        let extra = extra.map(|extra| like(extra, &self.in_proj.weight));
        let points = self.in_proj.forward(like(features, &self.in_proj.weight));
        let points = match extra {
            Some(extra) => points + extra,
            None => points,
        };
        let [batch, _, width] = points.dims();
        Tensor::cat(vec![self.bg_token.val().expand([batch, 1, width]), points], 1)
    }

    /// Similarity and overlap after block `index` from the tokens `[B, 1 + N, C]` of both clouds.
    pub fn compare(&self, index: usize, query: Tensor<3>, reference: Tensor<3>) -> BlockOutput {
        // Scores of all tokens, background first, [B, 1 + N].
        let scores = self.score_heads.map(|heads| {
            [&query, &reference].map(|tokens| {
                let [batch, n, _] = tokens.dims();
                single(heads[index].forward(tokens.clone())).reshape([batch, n])
            })
        });
        let part = |range: fn(usize) -> std::ops::Range<usize>| {
            scores.clone().map(|both| {
                both.map(|scores| {
                    let [batch, n] = scores.dims();
                    scores.slice([0..batch, range(n)])
                })
            })
        };
        let mut similarity = cosines(query, reference, self.out_proj, self.temperature);
        let (overlap, mut background_overlap) = (part(|n| 1..n), None);
        if let (true, Some([query, reference])) = (self.overlap_features, scores.clone()) {
            // Paper, overlap-aware correlation: features scaled by the confidences (the background's, too) before the
            // product, which scales the product.
            similarity =
                similarity * sigmoid(query).unsqueeze_dim::<3>(2) * sigmoid(reference).unsqueeze_dim::<3>(1);
            background_overlap = part(|_| 0..1);
        }
        BlockOutput { similarity, overlap, background_overlap }
    }
}

/// Unit length over the channels, with the norm clamped at 1e-12.
fn normalize(x: Tensor<3>) -> Tensor<3> {
    let norm = (x.clone() * x.clone()).sum_dim(2).sqrt().clamp_min(1e-12);
    x / norm
}
