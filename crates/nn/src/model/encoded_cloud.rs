//! What the matching stages need of one cloud of each pair.

use burn::tensor::Tensor;

use super::{SparseRows, rows::select_rows};

/// A batch of clouds after everything that looks at one cloud alone.
#[derive(Clone, Debug)]
pub struct EncodedCloud {
    /// Colour features of the dense points `[B, N, C_color]`.
    pub dense: Tensor<3>,
    /// Structure embedding of background and sparse points `[B, 1 + M, 1 + M, C]`.
    pub embedding: Tensor<4>,
    /// Sparse among dense points.
    pub rows: SparseRows,
    /// Positional encoding of the dense points `[B, N, C]`: the fine stage needs it.
    pub position: Option<Tensor<3>>,
    /// Layers of the stages that were computed ahead.
    pub attended: SelfAttended,
}

/// Sparse tokens of a cloud after the first self-attention of the coarse and of the fine stage, which does not look at the
/// other cloud, `[B, 1 + M, C]`; `None` where they are computed with the rest.
#[derive(Clone, Debug, Default)]
pub struct SelfAttended {
    /// Of the coarse stage.
    pub coarse: Option<Tensor<3>>,
    /// Of the fine stage.
    pub fine: Option<Tensor<3>>,
}

impl EncodedCloud {
    /// Without a positional encoding and layers ahead.
    pub fn new(dense: Tensor<3>, embedding: Tensor<4>, rows: SparseRows) -> Self {
        Self { dense, embedding, rows, position: None, attended: SelfAttended::default() }
    }

    /// Several of equal sizes as one batch, in order; `None` for none. A part that one of them lacks is left out.
    pub fn batch(items: &[&Self]) -> Option<Self> {
        fn joined<const D: usize>(tensors: impl Iterator<Item = Tensor<D>>) -> Tensor<D> {
            Tensor::cat(tensors.collect(), 0)
        }
        let first = items.first()?;
        let n = first.dense.dims()[1];
        let where_all_are = |part: fn(&Self) -> &Option<Tensor<3>>| {
            let tensors: Option<Vec<_>> = items.iter().map(|item| part(item).clone()).collect();
            tensors.map(|tensors| joined(tensors.into_iter()))
        };
        Some(Self {
            dense: joined(items.iter().map(|item| item.dense.clone())),
            embedding: joined(items.iter().map(|item| item.embedding.clone())),
            rows: SparseRows::batch(items.iter().map(|item| (&item.rows, item.dense.dims()[0])), n)?,
            position: where_all_are(|item| &item.position),
            attended: SelfAttended {
                coarse: where_all_are(|item| &item.attended.coarse),
                fine: where_all_are(|item| &item.attended.fine),
            },
        })
    }

    /// Colour features of the sparse points `[B, M, C_color]`.
    pub(super) fn sparse_features(&self) -> Tensor<3> {
        let [batch, n, width] = self.dense.dims();
        let count = self.rows.points.dims()[0];
        let dense = self.dense.clone().reshape([batch * n, width]);
        select_rows(dense, self.rows.points.clone()).reshape([batch, count / batch, width])
    }

    /// Size on the device.
    pub fn bytes(&self) -> usize {
        let optional = [&self.position, &self.attended.coarse, &self.attended.fine].into_iter().flatten();
        let numbers: usize = optional.map(|tensor| tensor.shape().num_elements()).sum();
        4 * (numbers + self.dense.shape().num_elements() + self.embedding.shape().num_elements())
    }
}
