//! The coarse and the fine matching stage.

// `PE` is the release's name, and derived code repeats it.
#![allow(non_snake_case)]

use burn::{
    module::{Module, Param},
    nn::Linear,
    tensor::{Int, Tensor},
};
use unopose_core::config::{ModelConfig, OverlapMode};

use super::{
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
    pub in_proj: Linear,
    pub out_proj: Linear,
    pub bg_token: Param<Tensor<3>>,
    pub score_heads: Option<Vec<Linear>>,
    pub transformers: Vec<GeometricTransformer>,
    temperature: f64,
    overlap_features: bool,
}

/// Sparse-to-dense transformer on all points.
#[derive(Module, Debug)]
pub struct FinePointMatching {
    pub in_proj: Linear,
    pub out_proj: Linear,
    pub bg_token: Param<Tensor<3>>,
    pub score_heads: Option<Vec<Linear>>,
    pub PE: PositionalEncoding,
    pub transformers: Vec<SparseToDenseTransformer>,
    temperature: f64,
    overlap_features: bool,
}

/// One cloud's inputs of the coarse stage.
#[derive(Clone, Debug)]
pub struct CoarseInput {
    /// Colour features of the sparse points `[B, M, C_color]`.
    pub features: Tensor<3>,
    /// Structure embedding `[B, 1 + M, 1 + M, C]`.
    pub embedding: Tensor<4>,
    /// What [`CoarsePointMatching::own`] gives of these, where it is known already.
    pub own: Option<Tensor<3>>,
}

/// One cloud's inputs of the fine stage.
#[derive(Clone, Debug)]
pub struct FineInput {
    /// Colour features of the dense points `[B, N, C_color]`.
    pub features: Tensor<3>,
    /// Positional encoding of the dense points `[B, N, C]`.
    pub position: Tensor<3>,
    /// Rows of the sparse tokens, see [`DenseTokens::sparse_rows`].
    pub sparse_rows: Tensor<1, Int>,
    /// Structure embedding `[B, 1 + M, 1 + M, C]`.
    pub embedding: Tensor<4>,
    /// What [`FinePointMatching::own`] gives of these, where it is known already.
    pub own: Option<Tensor<3>>,
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

    /// A cloud's tokens after the first layer, which does not look at the other cloud: `[B, 1 + M, C]`.
    pub fn own(&self, cloud: &CoarseInput) -> Tensor<3> {
        let tokens = self.head().tokens(cloud.features.clone(), None);
        match self.transformers.first() {
            Some(block) => block.own(tokens, like(cloud.embedding.clone(), &self.in_proj.weight)),
            None => tokens,
        }
    }

    /// Similarities and overlaps, one per compared block.
    pub fn forward(
        &self,
        query: CoarseInput,
        reference: CoarseInput,
        which: Supervision,
    ) -> Vec<BlockOutput> {
        let clouds = [&query, &reference];
        let [mut q, mut p] = clouds.map(|cloud| cloud.own.clone().unwrap_or_else(|| self.own(cloud)));
        let [from, to] = clouds.map(|cloud| like(cloud.embedding.clone(), &self.in_proj.weight));
        let mut outputs = Vec::new();
        for (index, block) in self.transformers.iter().enumerate() {
            if index > 0 {
                (q, p) = (block.own(q, from.clone()), block.own(p, to.clone()));
            }
            (q, p) = block.cross(q, p);
            if which == Supervision::AllBlocks || index + 1 == self.transformers.len() {
                outputs.push(self.head().compare(index, q.clone(), p.clone()));
            }
        }
        outputs
    }
}

impl FinePointMatching {
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

    fn tokens(&self, cloud: FineInput) -> DenseTokens {
        DenseTokens {
            features: self.head().tokens(cloud.features, Some(cloud.position)),
            sparse_rows: cloud.sparse_rows,
            embedding: like(cloud.embedding, &self.in_proj.weight),
            own: cloud.own,
        }
    }

    /// A cloud's sparse tokens after the first layer, which does not look at the other cloud: `[B, 1 + M, C]`.
    pub fn own(&self, cloud: FineInput) -> Option<Tensor<3>> {
        let block = self.transformers.first()?;
        let tokens = self.tokens(cloud);
        Some(block.sparse_layer.own(tokens.sparse(), tokens.embedding))
    }

    /// Similarities and overlaps, one per compared block.
    pub fn forward(&self, query: FineInput, reference: FineInput, which: Supervision) -> Vec<BlockOutput> {
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
