//! Geometric structure embedding (GeoTransformer; `docs/network.md`, section 4): sinusoids of pair distances and
//! triplet angles.

use burn::{
    module::Module,
    nn::Linear,
    tensor::{Device, Tensor, TensorData},
};
use rayon::prelude::*;
use unopose_core::{
    config::{EmbeddingEvaluation, GeoEmbeddingConfig},
    simd::vectorised,
};

use super::{fused::interpolated_embedding, init::Initializer};
use crate::device::is_host;

/// `proj_d(s(distance)) + max over neighbours of proj_a(s(angle))`.
#[derive(Module, Debug)]
pub struct GeometricStructureEmbedding {
    /// Map of the distances' sinusoids.
    pub proj_d: Linear,
    /// Map of the angles' sinusoids.
    pub proj_a: Linear,
    table: bool,
}

/// Table steps per unit of the index. A sinusoid's second derivative is at most 1, so linear interpolation errs by at
/// most step^2 / 8 = 1.9e-6 per channel before the linear map.
const STEPS_PER_UNIT: f32 = 256.0;
/// Largest table, rows. Clouds in radii need a few thousand; a larger one saves nothing.
const LARGEST_TABLE: f32 = 65_536.0;
/// Table rows that one task computes from one another.
const RUN: usize = 256;

impl GeometricStructureEmbedding {
    /// Initial weights.
    pub fn new(config: &GeoEmbeddingConfig, init: &mut Initializer) -> Self {
        Self {
            proj_d: init.linear(config.hidden_dim, config.hidden_dim),
            proj_a: init.linear(config.hidden_dim, config.hidden_dim),
            table: config.evaluation == EmbeddingEvaluation::Table,
        }
    }

    /// Distances `[B, M, M]` in units of sigma_d and angles `[B, M, M, k]` in units of sigma_a (no gradient to either)
    /// to the embedding `[B, M, M, C]`.
    ///
    /// The linear maps act on sinusoids of one scalar. With tables, and tensors in host memory, only the sinusoids of a
    /// grid are mapped, and every pair interpolates between two of them. The gradient reaches the weights through the
    /// mapped grid.
    pub fn forward(&self, distances: Tensor<3>, angles: Tensor<4>) -> Tensor<4> {
        let [batch, m, _, k] = angles.dims();
        let device = distances.device().inner();
        let [input, width] = self.proj_d.weight.dims();
        let pairs = batch * m * m;
        let (distances, angles) = (distances.reshape([pairs]), angles.reshape([pairs * k]));
        if self.table && is_host(&device) && pairs * k > 0 {
            let positions = [&distances, &angles].map(|index| index.clone() * STEPS_PER_UNIT);
            let largest = positions.each_ref().map(|positions| positions.clone().max().into_scalar::<f32>());
            if largest.iter().all(|&position| position < LARGEST_TABLE) {
                let tables =
                    [(&self.proj_d, largest[0]), (&self.proj_a, largest[1])].map(|(map, largest)| {
                        map.forward(sinusoid_grid(largest as usize + 2, input, &device)) // [entries, C]
                    });
                let [distances, angles] = positions;
                let embedding = interpolated_embedding(tables, distances, angles.reshape([pairs, k]));
                return embedding.reshape([batch, m, m, width]);
            }
        }
        let d = self.proj_d.forward(sinusoid(distances, input)); // [B M M, C]
        let a = self.proj_a.forward(sinusoid(angles, input)); // [B M M k, C]
        let a = a.reshape([pairs, k, width]).max_dim(1).reshape([pairs, width]);
        (d + a).reshape([batch, m, m, width])
    }
}

/// Interleaved sin, cos of `index * exp(-2 i ln(10000) / C)`: `[n] -> [n, C]`.
fn sinusoid(index: Tensor<1>, width: usize) -> Tensor<2> {
    let count = index.dims()[0];
    let frequencies =
        Tensor::<2>::from_data(TensorData::new(frequencies(width), [1, width / 2]), &index.device());
    let omega = index.unsqueeze_dim::<2>(1) * frequencies; // [n, C / 2]
    Tensor::stack::<3>(vec![omega.clone().sin(), omega.cos()], 2).reshape([count, width])
}

fn frequencies(width: usize) -> Vec<f32> {
    (0..width / 2).map(|i| ((2 * i) as f32 * (-(10000f32.ln()) / width as f32)).exp()).collect()
}

/// [`sinusoid`] of `entries` indices from 0 in table steps, `[entries, C]`: the first of every run from the library, the
/// others by turning it (in `f64`, so that nothing accumulates).
fn sinusoid_grid(entries: usize, width: usize, device: &Device) -> Tensor<2> {
    let frequencies: Vec<f64> =
        frequencies(width).into_iter().map(|f| f64::from(f) / f64::from(STEPS_PER_UNIT)).collect();
    let turns: Vec<(f64, f64)> = frequencies.iter().map(|f| f.sin_cos()).collect();
    let mut grid = vec![0.0f32; entries * width];
    grid.par_chunks_mut((RUN * width).max(1)).enumerate().for_each(|(run, rows)| {
        let mut now: Vec<(f64, f64)> =
            frequencies.iter().map(|f| (f * (run * RUN) as f64).sin_cos()).collect();
        vectorised!({
            for row in rows.chunks_exact_mut(width) {
                let entries = row.chunks_exact_mut(2).zip(now.iter_mut().zip(&turns));
                for (pair, ((sin, cos), (turn_sin, turn_cos))) in entries {
                    (pair[0], pair[1]) = (*sin as f32, *cos as f32);
                    (*sin, *cos) = (*sin * turn_cos + *cos * turn_sin, *cos * turn_cos - *sin * turn_sin);
                }
            }
        });
    });
    Tensor::from_data(TensorData::new(grid, [entries, width]), device)
}
