//! Operations in one parallel pass over memory where burn's own would make several on one thread.
//!
//! Each function states its plain form. It computes the same values by loops of its own when all tensors are `f32` in
//! the memory of the `flex` backend, plain or on the autodiff tape (with a written-down gradient), and by the plain form
//! everywhere else. The tests hold the two against each other.

#[cfg(feature = "flex")]
mod flex;
mod kernels;
mod layers;
mod projections;
#[cfg(test)]
mod tests;

use burn::{
    nn::Linear,
    tensor::{
        Int, Tensor, activation,
        module::{attention, layer_norm, linear},
        ops::AttentionModuleOptions,
    },
};

pub use kernels::Kernel;
pub use layers::{
    AttentionMaps, FocusedMaps, TokenMaps, VisionMaps, attention_layer, dense_layer, vision_block,
    vision_block_at,
};
pub use projections::{cosines, sampled_linear, weighted_rows};

/// `relu(x W + s)`: `[R, K] -> [R, C]`.
pub fn linear_relu(x: Tensor<2>, weight: Tensor<2>, shift: Tensor<1>) -> Tensor<2> {
    if let Some(y) = kernels::linear_relu(&x, &weight, &shift) {
        return y;
    }
    activation::relu(linear(x, weight, Some(shift)))
}

/// Largest of each `group` consecutive rows of `relu(x W + s)`: `[R, K] -> [R / group, C]`.
pub fn linear_relu_max(x: Tensor<2>, weight: Tensor<2>, shift: Tensor<1>, group: usize) -> Tensor<2> {
    if let Some(y) = kernels::linear_relu_max(&x, &weight, &shift, group) {
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
    if let Some(y) = kernels::shared_layers_max(&x, layers, group, counts) {
        return y;
    }
    let y = layers.iter().fold(x, |x, (w, s)| activation::relu(linear(x, w.clone(), Some(s.clone()))));
    let [rows, columns] = y.dims();
    y.reshape([rows / group, group, columns]).max_dim(1).reshape([rows / group, columns])
}

/// Weighted mean and second moments of rows `[R, K]` with weights `[R, 1]` (`None`: 1): `sum m x^T x / sum m` and, as
/// the last row, `sum m x / sum m`: `[K + 1, K]`.
pub fn row_moments(x: Tensor<2>, weights: Option<Tensor<2>>) -> Tensor<2> {
    if let Some(y) = kernels::row_moments(&x, weights.as_ref()) {
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

/// GELU in its exact (erf) form of a linear map, `[B, N, C]`.
pub fn linear_gelu(x: Tensor<3>, map: &Linear) -> Tensor<3> {
    if let Some(y) = kernels::linear_gelu(&x, map) {
        return y;
    }
    activation::gelu(map.forward(x))
}

/// GELU in its exact (erf) form.
pub fn gelu<const D: usize>(mut x: Tensor<D>) -> Tensor<D> {
    match kernels::gelu(&mut x) {
        Some(()) => x,
        None => activation::gelu(x),
    }
}

/// GELU of the layer norm over the channels, `[B, N, C]`.
pub fn layer_norm_gelu(mut x: Tensor<3>, gamma: Tensor<1>, beta: Tensor<1>, epsilon: f64) -> Tensor<3> {
    match kernels::layer_norm_gelu(&mut x, &gamma, &beta, epsilon) {
        Some(()) => x,
        None => activation::gelu(layer_norm(x, gamma, Some(beta), epsilon)),
    }
}

/// `residual + gamma map(x)` with a scale per channel, `[B, N, C]`.
pub fn linear_onto(residual: Tensor<3>, x: Tensor<3>, map: &Linear, gamma: Tensor<1>) -> Tensor<3> {
    if let Some(y) = kernels::linear_onto(&residual, &x, map, &gamma) {
        return y;
    }
    residual + map.forward(x) * gamma.unsqueeze()
}

/// `y = (relu(x) + epsilon) / scale`, then `y^3` with the norm of `y` over the channels: `[B, N, C]`, `scale` `[1, 1, C]`.
pub fn focus_cubed(x: Tensor<3>, scale: Tensor<3>, epsilon: f64) -> Tensor<3> {
    if let Some(y) = kernels::focus_cubed(&x, &scale, epsilon as f32) {
        return y;
    }
    let y = (activation::relu(x) + epsilon) / scale;
    let norm = |y: &Tensor<3>| (y.clone() * y.clone()).sum_dim(2).sqrt(); // [B, N, 1]
    let cube = y.clone() * y.clone() * y.clone();
    let ratio = norm(&y) / norm(&cube);
    cube * ratio
}

/// Scaled dot-product attention of tokens among themselves from their projections `[B, T, 3 C]` (query, key, value, the
/// heads one after the other in each): `[B, T, C]`.
pub fn self_attention(qkv: Tensor<3>, heads: usize) -> Tensor<3> {
    if let Some(y) = kernels::self_attention(&qkv, heads, None) {
        return y;
    }
    let [batch, tokens, joint] = qkv.dims();
    let [q, k, v] = of_heads(qkv, heads);
    let out = attention(q, k, v, None, None, AttentionModuleOptions::default());
    out.swap_dims(1, 2).reshape([batch, tokens, joint / 3])
}

/// Query, key and value `[B, H, T, d]` from joint projections `[B, T, 3 C]`.
fn of_heads(qkv: Tensor<3>, heads: usize) -> [Tensor<4>; 3] {
    let width = qkv.dims()[2] / 3;
    std::array::from_fn(|index| split_heads(qkv.clone().narrow(2, index * width, width), heads))
}

/// What is added to the scores of self attention before the softmax.
#[derive(Clone, Copy)]
pub enum PositionBias<'a> {
    /// A value for each head and pair of tokens: `[H, T, T]`.
    Table(&'a Tensor<3>),
    /// For tokens of a grid, row by row: the products of the (unscaled) query with embeddings of the query's and the key's
    /// row `[h, h, d]` and of their columns `[w, w, d]`, the same for all heads.
    Axes {
        /// `[h, h, d]`.
        rows: &'a Tensor<3>,
        /// `[w, w, d]`.
        columns: &'a Tensor<3>,
    },
}

/// [`self_attention`] with a bias of the scores.
pub fn positioned_self_attention(qkv: Tensor<3>, heads: usize, bias: PositionBias) -> Tensor<3> {
    if let Some(y) = kernels::self_attention(&qkv, heads, Some(bias)) {
        return y;
    }
    let [batch, tokens, joint] = qkv.dims();
    let [q, k, v] = of_heads(qkv, heads);
    // As many heads at a time as keep the biases below a quarter of a gigabyte.
    let at_once = ((1 << 26) / (batch * tokens * tokens).max(1)).clamp(1, heads);
    let groups = (0..heads).step_by(at_once).map(|first| {
        let some = |x: &Tensor<4>| x.clone().narrow(1, first, at_once.min(heads - first));
        let bias = match bias {
            PositionBias::Table(table) => some(&table.clone().unsqueeze()),
            PositionBias::Axes { rows, columns } => bias_of_axes(some(&q), rows.clone(), columns.clone()),
        };
        let options = AttentionModuleOptions::default();
        attention(some(&q), some(&k), some(&v), None, Some(bias), options)
    });
    Tensor::cat(groups.collect(), 1).swap_dims(1, 2).reshape([batch, tokens, joint / 3])
}

/// [`PositionBias::Axes`] of queries `[B, H, T, d]`: `[B, H, T, T]`.
fn bias_of_axes(queries: Tensor<4>, rows: Tensor<3>, columns: Tensor<3>) -> Tensor<4> {
    let [batch, heads, tokens, d] = queries.dims();
    let ([h, ..], [w, ..]) = (rows.dims(), columns.dims());
    let grid = queries.reshape([batch * heads, h, w, d]);
    let by_row = grid.clone().matmul(rows.swap_dims(1, 2).unsqueeze()); // [B H, h, w, h]
    let by_column = grid.swap_dims(1, 2).matmul(columns.swap_dims(1, 2).unsqueeze()); // [B H, w, h, w]
    let by_row: Tensor<5> = by_row.reshape([batch, heads, tokens, h, 1]);
    let by_column: Tensor<5> = by_column.swap_dims(1, 2).reshape([batch, heads, tokens, 1, w]);
    (by_row + by_column).reshape([batch, heads, tokens, tokens])
}

/// Scores of the relative positions, `sum_c projected[b, h, n, c] embedding[b, n, m, c]`: `[B, H, N, C]` and
/// `[B, N, M, C]` to `[B, H, N, M]`.
pub fn relative_scores(projected: Tensor<4>, embedding: Tensor<4>) -> Tensor<4> {
    if let Some(y) = kernels::relative_scores(&projected, &embedding) {
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

/// `softmax(q k^T + position) v` in each head: queries `[B, N, C]`, already scaled, keys and values `[B, M, C]`, `position`
/// `[B, H, N, M]`; `[B, N, C]`.
pub fn softmax_attention(
    queries: Tensor<3>,
    keys: Tensor<3>,
    values: Tensor<3>,
    position: Option<Tensor<4>>,
    heads: usize,
) -> Tensor<3> {
    if let Some(y) = kernels::softmax_attention([&queries, &keys, &values], position.as_ref(), heads) {
        return y;
    }
    let shape = queries.dims();
    let [q, k, v] = [queries, keys, values].map(|x| split_heads(x, heads));
    let scores = q.matmul(k.swap_dims(2, 3));
    let scores = match position {
        Some(position) => scores + position,
        None => scores,
    };
    activation::softmax(scores, 3).matmul(v).swap_dims(1, 2).reshape(shape)
}

/// `[B, N, C] -> [B, H, N, C / H]`.
pub fn split_heads(x: Tensor<3>, heads: usize) -> Tensor<4> {
    let [batch, n, width] = x.dims();
    x.reshape([batch, n, heads, width / heads]).swap_dims(1, 2)
}

/// Sum of the distance row and the largest of the `k` angle rows of each pair, linearly interpolated in tables
/// `[entries, C]` of the mapped sinusoids. Positions are in table rows, `[n]` and `[n, k]`, without gradients.
pub fn interpolated_embedding(tables: [Tensor<2>; 2], distances: Tensor<1>, angles: Tensor<2>) -> Tensor<2> {
    if let Some(y) = kernels::interpolated_embedding(&tables, &distances, &angles) {
        return y;
    }
    let rows = |table: &Tensor<2>, positions: Tensor<1>| {
        let low = positions.clone().floor();
        let fraction = (positions - low.clone()).unsqueeze_dim::<2>(1);
        let low: Tensor<1, Int> = low.int();
        let below = table.clone().select(0, low.clone());
        below.clone() + (table.clone().select(0, low + 1) - below) * fraction
    };
    let [n, k] = angles.dims();
    let [_, width] = tables[1].dims();
    let angles = rows(&tables[1], angles.reshape([n * k])).reshape([n, k, width]);
    rows(&tables[0], distances) + angles.max_dim(1).reshape([n, width])
}
