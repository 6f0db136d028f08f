//! Operations in one parallel pass over memory where burn's own would make several on one thread.
//!
//! Each function states its plain form. It computes the same values by loops of its own when all tensors are `f32` in
//! the memory of the `flex` backend, plain or on the autodiff tape (with a written-down gradient), and by the plain form
//! everywhere else. The tests hold the two against each other.

#[cfg(feature = "flex")]
mod gelu;
#[cfg(feature = "flex")]
mod linear_relu;
#[cfg(feature = "flex")]
mod moments;
#[cfg(feature = "flex")]
mod pooled;
#[cfg(feature = "flex")]
mod relative_scores;
#[cfg(feature = "flex")]
mod tape;
#[cfg(test)]
mod tests;

use burn::tensor::{Tensor, activation, module::linear};

/// Rows per parallel task; fixed, so that sums over rows do not depend on the number of threads.
#[cfg(feature = "flex")]
const BLOCK: usize = 512;

/// `relu(x W + s)`: `[R, K] -> [R, C]`.
pub fn linear_relu(x: Tensor<2>, weight: Tensor<2>, shift: Tensor<1>) -> Tensor<2> {
    #[cfg(feature = "flex")]
    if let Some(y) = linear_relu::linear_relu(&x, &weight, &shift) {
        return y;
    }
    activation::relu(linear(x, weight, Some(shift)))
}

/// Largest of each `group` consecutive rows of `relu(x W + s)`: `[R, K] -> [R / group, C]`.
pub fn linear_relu_max(x: Tensor<2>, weight: Tensor<2>, shift: Tensor<1>, group: usize) -> Tensor<2> {
    #[cfg(feature = "flex")]
    if let Some(y) = pooled::linear_relu_max(&x, &weight, &shift, group) {
        return y;
    }
    let y = activation::relu(linear(x, weight, Some(shift)));
    let [rows, columns] = y.dims();
    y.reshape([rows / group, group, columns]).max_dim(1).reshape([rows / group, columns])
}

/// Layers `relu(x W + s)` one after the other, then the largest of each `group` consecutive rows: `[R, K] -> [R / group,
/// C]`, without gradients. `counts` says how many rows of each group are worth computing, the rest being repetitions.
pub fn shared_layers_max(
    x: Tensor<2>,
    layers: &[(Tensor<2>, Tensor<1>)],
    group: usize,
    counts: &[u32],
) -> Tensor<2> {
    #[cfg(feature = "flex")]
    if let Some(y) = pooled::shared_layers_max(&x, layers, group, counts) {
        return y;
    }
    let _ = counts;
    let y = layers.iter().fold(x, |x, (w, s)| activation::relu(linear(x, w.clone(), Some(s.clone()))));
    let [rows, columns] = y.dims();
    y.reshape([rows / group, group, columns]).max_dim(1).reshape([rows / group, columns])
}

/// Weighted mean and second moments of rows `[R, K]` with weights `[R, 1]` (`None`: 1): `sum m x^T x / sum m` and, as
/// the last row, `sum m x / sum m`: `[K + 1, K]`.
pub fn row_moments(x: Tensor<2>, weights: Option<Tensor<2>>) -> Tensor<2> {
    #[cfg(feature = "flex")]
    if let Some(y) = moments::row_moments(&x, weights.as_ref()) {
        return y;
    }
    let (count, weighted) = match weights {
        None => (Tensor::full([1, 1], x.dims()[0] as f32, &x.device().inner()), x.clone()),
        Some(weights) => (weights.clone().sum_dim(0), x.clone() * weights),
    };
    let mean = weighted.clone().sum_dim(0) / count.clone();
    let second = x.transpose().matmul(weighted) / count;
    Tensor::cat(vec![second, mean], 0)
}

/// [`activation::gelu`], exact (erf) form.
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    #[cfg(feature = "flex")]
    let x = {
        let mut x = x;
        if gelu::gelu(&mut x) {
            return x;
        }
        x
    };
    activation::gelu(x)
}

/// Scores of the relative positions, `sum_c projected[b, h, n, c] embedding[b, n, m, c]`: `[B, H, N, C]` and
/// `[B, N, M, C]` to `[B, H, N, M]`.
pub fn relative_scores(projected: Tensor<4>, embedding: Tensor<4>) -> Tensor<4> {
    #[cfg(feature = "flex")]
    if let Some(y) = relative_scores::relative_scores(&projected, &embedding) {
        return y;
    }
    let [batch, heads, n, width] = projected.dims();
    let m = embedding.dims()[2];
    embedding
        .reshape([batch * n, m, width])
        .matmul(projected.permute([0, 2, 3, 1]).reshape([batch * n, width, heads])) // [B N, M, H]
        .reshape([batch, n, m, heads])
        .permute([0, 3, 1, 2])
}
