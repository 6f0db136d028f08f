//! One fine block: geometric transformer on the sparse tokens, linear attention back to the dense ones.

use burn::{
    module::Module,
    tensor::{Int, Tensor},
};
use unopose_core::config::FineConfig;

use super::{
    init::Initializer, linear_attention::LinearTransformerLayer, rows::select_rows,
    transformer::GeometricTransformer,
};

/// `sparse_layer` then `dense_layer`.
#[derive(Module, Debug)]
pub struct SparseToDenseTransformer {
    /// Self- and cross-attention of the sparse tokens.
    pub sparse_layer: GeometricTransformer,
    /// Dense tokens attend to sparse ones.
    pub dense_layer: LinearTransformerLayer,
}

/// Dense tokens of one cloud with what the block needs to thin them out.
pub struct DenseTokens {
    /// `[B, 1 + N, C]`, background first.
    pub features: Tensor<3>,
    /// Rows of the sparse tokens in the flattened `[B * (1 + N)]` token list, background included: `[B * (1 + M)]`.
    pub sparse_rows: Tensor<1, Int>,
    /// Structure embedding of the sparse points `[B, 1 + M, 1 + M, C]`.
    pub embedding: Tensor<4>,
    /// The sparse tokens after the next block's self-attention `[B, 1 + M, C]`, where it was computed ahead.
    pub attended: Option<Tensor<3>>,
}

impl DenseTokens {
    /// `[B, 1 + M, C]`.
    pub(super) fn sparse(&self) -> Tensor<3> {
        let [batch, tokens, width] = self.features.dims();
        let rows = self.sparse_rows.dims()[0];
        let dense = self.features.clone().reshape([batch * tokens, width]);
        select_rows(dense, self.sparse_rows.clone()).reshape([batch, rows / batch, width])
    }
}

impl SparseToDenseTransformer {
    /// Initial weights.
    pub fn new(config: &FineConfig, init: &mut Initializer) -> Self {
        let matching = &config.matching;
        Self {
            sparse_layer: GeometricTransformer::new(matching.hidden_dim, matching.heads, init),
            dense_layer: LinearTransformerLayer::new(
                matching.hidden_dim,
                matching.heads,
                config.focusing_factor,
                init,
            ),
        }
    }

    /// Updates the features of both clouds.
    pub fn forward(&self, query: DenseTokens, reference: DenseTokens) -> (DenseTokens, DenseTokens) {
        let [attended_query, attended_reference] = [&query, &reference].map(|cloud| match &cloud.attended {
            Some(attended) => attended.clone(),
            None => self.sparse_layer.self_attention(cloud.sparse(), cloud.embedding.clone()),
        });
        let (sparse_query, sparse_reference) =
            self.sparse_layer.cross_attention(attended_query, attended_reference);
        (self.densify(query, sparse_query), self.densify(reference, sparse_reference))
    }

    /// Dense tokens after they attended to the sparse ones.
    fn densify(&self, dense: DenseTokens, sparse: Tensor<3>) -> DenseTokens {
        DenseTokens { features: self.dense_layer.attend(dense.features, sparse), attended: None, ..dense }
    }
}
