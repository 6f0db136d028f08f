//! Cosines and bilinear samples of linear maps.

use burn::{
    nn::Linear,
    tensor::{FloatDType, Int, Tensor, TensorData},
};

use crate::model::{matching::BlockOutput, precision::single, rows::select_rows};

/// Cosines of mapped tokens `[B, N, K]` and `[B, M, K]` over a temperature, `[B, N, M]`.
pub fn cosines(a: Tensor<3>, b: Tensor<3>, map: &Linear, temperature: f64) -> Tensor<3> {
    if let Some(y) = super::kernels::cosines(&a, &b, map, (1.0 / temperature) as f32) {
        return y;
    }
    BlockOutput::cosine_similarity(single(map.forward(a)), single(map.forward(b)), temperature)
}

/// Rows of `x W + b` are mapped `[cells, width]` to take apart: sums of four of the `[R * cells, width]` with `weights`,
/// `[4 n]` rows and weights to `[n, width]`.
pub fn sampled_linear(
    x: Tensor<2>,
    map: &Linear,
    width: usize,
    rows: Vec<i32>,
    weights: Vec<f32>,
) -> Tensor<2> {
    if let Some(y) = super::kernels::sampled_linear(&x, map, width, &rows, &weights) {
        return y;
    }
    let mapped = map.forward(x);
    let count = mapped.shape().num_elements() / width;
    weighted_rows(mapped.reshape([count, width]), rows, weights)
}

/// Sums of four weighted rows of `map` `[R, C]` each: `[n, C]` from `4 n` rows and weights.
pub fn weighted_rows(map: Tensor<2>, rows: Vec<i32>, weights: Vec<f32>) -> Tensor<2> {
    let [_, channels] = map.dims();
    let device = map.device().inner();
    let count = rows.len();
    let rows = Tensor::<1, Int>::from_data(TensorData::new(rows, [count]), &device);
    let weights = Tensor::<3>::from_data(TensorData::new(weights, [count / 4, 4, 1]), &device);
    let weights = weights.cast(FloatDType::from(map.dtype()));
    select_rows(map, rows)
        .reshape([count / 4, 4, channels])
        .mul(weights)
        .sum_dim(1)
        .reshape([count / 4, channels])
}
