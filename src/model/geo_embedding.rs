//! Geometric structure embedding (GeoTransformer, section 3.2): sinusoids of pair distances and triplet angles.

use burn::{
    module::Module,
    nn::Linear,
    tensor::{Tensor, TensorData},
};
use rayon::prelude::*;

use super::init::Initializer;
use crate::{
    config::{EmbeddingEvaluation, GeoEmbeddingConfig},
    device::is_host,
    simd::vectorised,
};

/// `proj_d(s(distance)) + max over neighbours of proj_a(s(angle))`.
#[derive(Module, Debug)]
pub struct GeometricStructureEmbedding {
    pub proj_d: Linear,
    pub proj_a: Linear,
    table: bool,
}

/// Table steps per unit of the index. A sinusoid's second derivative is at most 1, so linear interpolation errs by at
/// most step^2 / 8 = 1.9e-6 per channel before the linear map.
const STEPS_PER_UNIT: f32 = 256.0;

impl GeometricStructureEmbedding {
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
    /// The linear maps act on sinusoids of one scalar. With tables, and tensors in host memory, inference interpolates
    /// in tables of the mapped sinusoids; training interpolates the sinusoids and maps them, so that the gradient
    /// reaches the weights through one matrix product.
    pub fn forward(&self, distances: Tensor<3>, angles: Tensor<4>) -> Tensor<4> {
        let [batch, m, _, k] = angles.dims();
        let device = distances.device();
        let [input, width] = self.proj_d.weight.dims();
        let (distances, angles) = (distances.reshape([batch * m * m]), angles.reshape([batch * m * m * k]));
        let on_tape = self.proj_d.weight.val().is_autodiff();
        if self.table && is_host(&device) && !on_tape {
            let mapped = [(&self.proj_d, distances), (&self.proj_a, angles)].map(|(map, index)| {
                let index = host(index);
                let grid = host_sinusoids(&grid(&index), input);
                let entries = grid.len() / input;
                let grid = Tensor::<2>::from_data(TensorData::new(grid, [entries, input]), &device);
                (host(map.forward(grid)), index)
            });
            let embedding = interpolate_embedding(&mapped[0], &mapped[1], width, k);
            return Tensor::from_data(TensorData::new(embedding, [batch, m, m, width]), &device);
        }
        let sinusoids = |index: Tensor<1>| {
            if self.table && is_host(&device) {
                let count = index.dims()[0];
                let index = host(index);
                let rows = interpolate_rows(&host_sinusoids(&grid(&index), input), &index, input);
                Tensor::from_data(TensorData::new(rows, [count, input]), &device)
            } else {
                sinusoid(index, input)
            }
        };
        let d = self.proj_d.forward(sinusoids(distances)); // [B M M, C]
        let a = self.proj_a.forward(sinusoids(angles)); // [B M M k, C]
        let a = a.reshape([batch * m * m, k, width]).max_dim(1).reshape([batch * m * m, width]);
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

/// Positions of a table that covers all of `index`.
fn grid(index: &[f32]) -> Vec<f32> {
    let largest = index.par_iter().copied().reduce(|| 0.0, f32::max);
    (0..(largest * STEPS_PER_UNIT) as usize + 2).map(|i| i as f32 / STEPS_PER_UNIT).collect()
}

/// [`sinusoid`] on the host.
fn host_sinusoids(index: &[f32], width: usize) -> Vec<f32> {
    let frequencies = frequencies(width);
    let mut rows = vec![0.0; index.len() * width];
    rows.par_chunks_exact_mut(width).zip(index).for_each(|(row, &x)| {
        for (pair, frequency) in row.chunks_exact_mut(2).zip(&frequencies) {
            let (sin, cos) = (x * frequency).sin_cos();
            pair.copy_from_slice(&[sin, cos]);
        }
    });
    rows
}

/// Table rows below and above `x` and the weight of the latter.
#[inline(always)]
fn bracket(table: &[f32], width: usize, x: f32) -> (&[f32], &[f32], f32) {
    let position = x * STEPS_PER_UNIT;
    let low = position as usize;
    let rows = &table[low * width..(low + 2) * width];
    (&rows[..width], &rows[width..], position - low as f32)
}

/// Rows of `table` `[entries, C]` at `index`, linearly interpolated: `[n, C]`.
fn interpolate_rows(table: &[f32], index: &[f32], width: usize) -> Vec<f32> {
    let mut rows = vec![0.0; index.len() * width];
    rows.par_chunks_exact_mut(width).with_min_len(1024).zip(index).for_each(|(row, &x)| {
        let (below, above, fraction) = bracket(table, width, x);
        vectorised(|| {
            for ((value, &b), &a) in row.iter_mut().zip(below).zip(above) {
                *value = b + (a - b) * fraction;
            }
        });
    });
    rows
}

/// Sum of the interpolated distance row and the maximum of the `k` interpolated angle rows: `[n, C]`. Each argument is
/// a table and the positions in it.
fn interpolate_embedding(
    (table_d, distances): &(Vec<f32>, Vec<f32>),
    (table_a, angles): &(Vec<f32>, Vec<f32>),
    width: usize,
    k: usize,
) -> Vec<f32> {
    let mut rows = vec![0.0; distances.len() * width];
    let items = rows.par_chunks_exact_mut(width).zip(distances).zip(angles.par_chunks_exact(k));
    items.with_min_len(512).for_each_init(
        || vec![0.0f32; width],
        |largest, ((row, &distance), angles)| {
            vectorised(|| {
                largest.fill(f32::NEG_INFINITY);
                for &angle in angles {
                    let (below, above, fraction) = bracket(table_a, width, angle);
                    for ((value, &b), &a) in largest.iter_mut().zip(below).zip(above) {
                        *value = value.max(b + (a - b) * fraction);
                    }
                }
                let (below, above, fraction) = bracket(table_d, width, distance);
                for (((value, &b), &a), &angle) in row.iter_mut().zip(below).zip(above).zip(&*largest) {
                    *value = b + (a - b) * fraction + angle;
                }
            });
        },
    );
    rows
}

/// Values of a tensor that already is in host memory.
fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().unwrap_or_default()
}
