//! The coarse and the fine matching stage.

// `PE` is the release's name, and derived code repeats it.
#![allow(non_snake_case)]

use burn::{
    module::{Module, Param},
    nn::Linear,
    tensor::Tensor,
};
use unopose_core::config::{ModelConfig, OverlapMode};

use super::{
    EncodedCloud,
    init::Initializer,
    matching::{BlockOutput, HeadParameters, MatchingHead},
    positional_encoding::{GroupTensors, PositionalEncoding},
    precision::like,
    sparse_to_dense::{DenseTokens, SparseToDenseTransformer},
    transformer::GeometricTransformer,
};

/// Geometric transformer on the sparse points.
#[derive(Module, Debug)]
pub struct CoarsePointMatching {
    /// Colour features to tokens.
    pub in_proj: Linear,
    /// Tokens to the features that are compared.
    pub out_proj: Linear,
    /// The background's token `[1, 1, C]`.
    pub bg_token: Param<Tensor<3>>,
    /// Overlap heads, one per block; `None` with `overlap = "off"`.
    pub score_heads: Option<Vec<Linear>>,
    /// The blocks.
    pub transformers: Vec<GeometricTransformer>,
    temperature: f64,
    overlap_features: bool,
}

/// Sparse-to-dense transformer on all points.
#[derive(Module, Debug)]
pub struct FinePointMatching {
    /// Colour features to tokens.
    pub in_proj: Linear,
    /// Tokens to the features that are compared.
    pub out_proj: Linear,
    /// The background's token `[1, 1, C]`.
    pub bg_token: Param<Tensor<3>>,
    /// Overlap heads, one per block; `None` with `overlap = "off"`.
    pub score_heads: Option<Vec<Linear>>,
    /// Positional encoding.
    pub PE: PositionalEncoding,
    /// The blocks.
    pub transformers: Vec<SparseToDenseTransformer>,
    temperature: f64,
    overlap_features: bool,
}

/// Which blocks are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervision {
    /// Every block (training).
    AllBlocks,
    /// The last block only (inference).
    LastBlock,
}

impl CoarsePointMatching {
    /// Initial weights.
    pub fn new(config: &ModelConfig, init: &mut Initializer) -> Self {
        let stage = &config.coarse;
        let HeadParameters { in_proj, out_proj, bg_token, score_heads } =
            HeadParameters::new(config.color.out_dim(), stage, config.overlap, init);
        Self {
            in_proj,
            out_proj,
            bg_token,
            score_heads,
            transformers: (0..stage.blocks)
                .map(|_| GeometricTransformer::new(stage.hidden_dim, stage.heads, init))
                .collect(),
            temperature: stage.temperature as f64,
            overlap_features: config.overlap == OverlapMode::Paper,
        }
    }

    fn head(&self) -> MatchingHead<'_> {
        MatchingHead {
            in_proj: &self.in_proj,
            out_proj: &self.out_proj,
            bg_token: &self.bg_token,
            score_heads: self.score_heads.as_deref(),
            temperature: self.temperature,
            overlap_features: self.overlap_features,
        }
    }

    /// A cloud's tokens after the first self-attention, which does not look at the other cloud: `[B, 1 + M, C]`.
    pub fn self_attention(&self, cloud: &EncodedCloud) -> Tensor<3> {
        let tokens = self.head().tokens(cloud.sparse_features(), None);
        match self.transformers.first() {
            Some(block) => block.self_attention(tokens, like(cloud.embedding.clone(), &self.in_proj.weight)),
            None => tokens,
        }
    }

    /// Similarities and overlaps, one per compared block.
    pub fn forward(
        &self,
        query: &EncodedCloud,
        reference: &EncodedCloud,
        which: Supervision,
    ) -> Vec<BlockOutput> {
        let clouds = [query, reference];
        let [mut q, mut p] =
            clouds.map(|cloud| cloud.attended.coarse.clone().unwrap_or_else(|| self.self_attention(cloud)));
        let [from, to] = clouds.map(|cloud| like(cloud.embedding.clone(), &self.in_proj.weight));
        let mut outputs = Vec::new();
        for (index, block) in self.transformers.iter().enumerate() {
            if index > 0 {
                (q, p) = (block.self_attention(q, from.clone()), block.self_attention(p, to.clone()));
            }
            (q, p) = block.cross_attention(q, p);
            if which == Supervision::AllBlocks || index + 1 == self.transformers.len() {
                outputs.push(self.head().compare(index, q.clone(), p.clone()));
            }
        }
        outputs
    }
}

impl FinePointMatching {
    /// Initial weights.
    pub fn new(config: &ModelConfig, init: &mut Initializer) -> Self {
        let stage = &config.fine.matching;
        let HeadParameters { in_proj, out_proj, bg_token, score_heads } =
            HeadParameters::new(config.color.out_dim(), stage, config.overlap, init);
        Self {
            in_proj,
            out_proj,
            bg_token,
            score_heads,
            PE: PositionalEncoding::new(&config.fine, init),
            transformers: (0..stage.blocks)
                .map(|_| SparseToDenseTransformer::new(&config.fine, init))
                .collect(),
            temperature: stage.temperature as f64,
            overlap_features: config.overlap == OverlapMode::Paper,
        }
    }

    fn head(&self) -> MatchingHead<'_> {
        MatchingHead {
            in_proj: &self.in_proj,
            out_proj: &self.out_proj,
            bg_token: &self.bg_token,
            score_heads: self.score_heads.as_deref(),
            temperature: self.temperature,
            overlap_features: self.overlap_features,
        }
    }

    /// Positional encoding `[B, N, C]` of a cloud's neighbourhoods.
    pub fn position(&self, groups: &[GroupTensors; 2]) -> Tensor<3> {
        self.PE.forward(groups)
    }

    fn tokens(&self, cloud: &EncodedCloud) -> DenseTokens {
        DenseTokens {
            features: self.head().tokens(cloud.dense.clone(), cloud.position.clone()),
            sparse_rows: cloud.rows.tokens.clone(),
            embedding: like(cloud.embedding.clone(), &self.in_proj.weight),
            attended: cloud.attended.fine.clone(),
        }
    }

    /// A cloud's sparse tokens after the first self-attention, which does not look at the other cloud: `[B, 1 + M, C]`.
    pub fn self_attention(&self, cloud: &EncodedCloud) -> Option<Tensor<3>> {
        let block = self.transformers.first()?;
        let tokens = self.tokens(cloud);
        Some(block.sparse_layer.self_attention(tokens.sparse(), tokens.embedding))
    }

    /// Similarities and overlaps, one per compared block, of clouds with positional encodings.
    pub fn forward(
        &self,
        query: &EncodedCloud,
        reference: &EncodedCloud,
        which: Supervision,
    ) -> Vec<BlockOutput> {
        let [mut q, mut p] = [query, reference].map(|cloud| self.tokens(cloud));
        let mut outputs = Vec::new();
        for (index, block) in self.transformers.iter().enumerate() {
            (q, p) = block.forward(q, p);
            if which == Supervision::AllBlocks || index + 1 == self.transformers.len() {
                outputs.push(self.head().compare(index, q.features.clone(), p.features.clone()));
            }
        }
        outputs
    }
}
