//! Geometric structure embedding (GeoTransformer, section 3.2): sinusoids of pair distances and triplet angles.

use burn::{
    module::Module,
    nn::Linear,
    tensor::{Device, Int, Tensor, TensorData},
};

use super::init::Initializer;
use crate::config::{EmbeddingEvaluation, GeoEmbeddingConfig};

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
    pub fn forward(&self, distances: Tensor<3>, angles: Tensor<4>) -> Tensor<4> {
        let [batch, m, _, k] = angles.dims();
        let embed = |linear: &Linear, index: Tensor<1>| {
            if self.table {
                interpolate_table(linear, index)
            } else {
                linear.forward(sinusoid(index, linear))
            }
        };
        let width = self.proj_d.weight.dims()[1];
        let d = embed(&self.proj_d, distances.reshape([batch * m * m])); // [B M M, C]
        let a = embed(&self.proj_a, angles.reshape([batch * m * m * k])); // [B M M k, C]
        let a = a.reshape([batch * m * m, k, width]).max_dim(1).reshape([batch * m * m, width]);
        (d + a).reshape([batch, m, m, width])
    }
}

/// Interleaved sin, cos of `index * exp(-2 i ln(10000) / C)`: `[n] -> [n, C]`.
fn sinusoid(index: Tensor<1>, linear: &Linear) -> Tensor<2> {
    let width = linear.weight.dims()[0];
    let count = index.dims()[0];
    let omega = index.clone().unsqueeze_dim::<2>(1) * frequencies(width, &index.device()); // [n, C / 2]
    Tensor::stack::<3>(vec![omega.clone().sin(), omega.cos()], 2).reshape([count, width])
}

fn frequencies(width: usize, device: &Device) -> Tensor<2> {
    let values: Vec<f32> =
        (0..width / 2).map(|i| ((2 * i) as f32 * (-(10000f32.ln()) / width as f32)).exp()).collect();
    Tensor::from_data(TensorData::new(values, [1, width / 2]), device)
}

/// `linear(sinusoid(index))` by linear interpolation in a table that is computed from the current weights, so gradients
/// reach them through the table.
fn interpolate_table(linear: &Linear, index: Tensor<1>) -> Tensor<2> {
    let device = index.device();
    let position = index * STEPS_PER_UNIT;
    let largest = position.clone().max().into_scalar::<f32>();
    let entries = largest as usize + 2;
    let grid = Tensor::<1, Int>::arange(0..entries as i64, &device).float() / STEPS_PER_UNIT;
    let table = linear.forward(sinusoid(grid, linear)); // [entries, C]
    let low = position.clone().floor();
    let fraction = (position - low.clone()).unsqueeze_dim::<2>(1); // [n, 1]
    let low = low.int();
    let below = table.clone().select(0, low.clone());
    let above = table.select(0, low + 1);
    below.clone() + (above - below) * fraction
}
