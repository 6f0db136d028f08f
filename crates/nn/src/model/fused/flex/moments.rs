//! Second moments and mean of rows, and their gradient, in one pass each.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, add_transposed_product};

use super::{
    BLOCK,
    linear_relu::{column_sums, merged},
    tape::{Gradient, Input, Values, plain, record},
};

pub fn row_moments(x: &Tensor<2>, weights: Option<&Tensor<2>>) -> Option<Tensor<2>> {
    let [_, width] = x.dims();
    let weights = match weights {
        None => None,
        Some(weights) => Some(Values::of(weights)?),
    };
    let shape = [width + 1, width];
    if let Some(x) = Values::of(x) {
        return Some(plain(forward(&x, weights.as_deref(), width), shape));
    }
    let input = Input::of(x)?;
    let moments = forward(&input.values, weights.as_deref(), width);
    record([input], moments, shape, |[x], _| Moments { x, weights, width })
}

/// Rows times their weights.
fn weighted(x: &[f32], weights: Option<&[f32]>, block: usize, width: usize) -> Vec<f32> {
    let mut rows = x.to_vec();
    if let Some(weights) = weights {
        let weights = &weights[block * BLOCK..];
        for (row, &weight) in rows.chunks_exact_mut(width).zip(weights) {
            row.iter_mut().for_each(|x| *x *= weight);
        }
    }
    rows
}

fn total(weights: Option<&[f32]>, rows: usize) -> f32 {
    weights.map_or(rows as f64, |weights| weights.iter().map(|&w| f64::from(w)).sum()) as f32
}

fn forward(x: &[f32], weights: Option<&[f32]>, width: usize) -> Vec<f32> {
    let sums: Vec<(Vec<f32>, Vec<f32>)> = x
        .par_chunks(BLOCK * width)
        .enumerate()
        .map(|(block, x)| {
            let rows = weighted(x, weights, block, width);
            let mut second = vec![0.0; width * width];
            add_transposed_product(&mut second, x, &rows, x.len() / width);
            (second, column_sums(&rows, width))
        })
        .collect();
    let [second, first] = merged(sums, width * width, width);
    let total = total(weights, x.len() / width);
    second.into_iter().chain(first).map(|sum| sum / total).collect()
}

#[derive(Clone, Debug)]
struct Moments {
    x: Values,
    weights: Option<Values>,
    width: usize,
}

impl Gradient<1> for Moments {
    /// `dx = m / sum m (x (G + G^T) + g)`.
    fn gradients(&self, output: &[f32], _: [bool; 1]) -> [(Vec<f32>, Vec<usize>); 1] {
        let width = self.width;
        let (second, first) = output.split_at(width * width);
        let symmetric: Vec<f32> =
            (0..width * width).map(|i| second[i] + second[i % width * width + i / width]).collect();
        let total = total(self.weights.as_deref(), self.x.len() / width);
        let mut dx = vec![0.0; self.x.len()];
        dx.par_chunks_mut(BLOCK * width).zip(self.x.par_chunks(BLOCK * width)).enumerate().for_each(
            |(block, (dx, x))| {
                dx.chunks_exact_mut(width).for_each(|row| row.copy_from_slice(first));
                add_product(dx, x, &symmetric, width);
                for (r, row) in dx.chunks_exact_mut(width).enumerate() {
                    let weight = self.weights.as_ref().map_or(1.0, |w| w[block * BLOCK + r]) / total;
                    row.iter_mut().for_each(|d| *d *= weight);
                }
            },
        );
        [(dx, vec![self.x.len() / width, width])]
    }
}
