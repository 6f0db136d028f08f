//! Residual sum and layer norm, forth and back in one pass each.

use burn::{nn::LayerNorm, tensor::Tensor};
use rayon::prelude::*;
use unopose_core::simd::{dot, sum, vectorised};

use super::{
    linear_relu::merged,
    tape::{Gradient, Input, Values, plain, record},
};

/// Rows per parallel task; fixed, so that sums over rows do not depend on the number of threads.
const ROWS: usize = 64;

pub fn add_layer_norm(
    norm: &LayerNorm,
    epsilon: f64,
    x: &Tensor<3>,
    residual: &Tensor<3>,
) -> Option<Tensor<3>> {
    let shape = x.dims();
    if shape != residual.dims() {
        return None;
    }
    let (gamma, beta) = (norm.gamma.val(), norm.beta.as_ref()?.val());
    let epsilon = epsilon as f32;
    if let (Some(x), Some(r), Some(g), Some(b)) =
        (Values::of(x), Values::of(residual), Values::of(&gamma), Values::of(&beta))
    {
        return Some(plain(forward(&x, &r, &g, &b, epsilon).0, shape));
    }
    let inputs = [Input::of(x)?, Input::of(residual)?, Input::of(&gamma)?, Input::of(&beta)?];
    let [x, r, g, b] = &inputs;
    let (y, scales) = forward(&x.values, &r.values, &g.values, &b.values, epsilon);
    record(inputs, y, shape, |[x, residual, gamma, _], _| Norm { x, residual, gamma, scales, shape })
}

/// Normalised rows, and the reciprocal of each one's standard deviation.
fn forward(x: &[f32], residual: &[f32], gamma: &[f32], beta: &[f32], epsilon: f32) -> (Vec<f32>, Vec<f32>) {
    let width = gamma.len();
    let (mut y, mut scales) = (vec![0.0f32; x.len()], vec![0.0f32; x.len() / width.max(1)]);
    let inputs = x.par_chunks(ROWS * width).zip(residual.par_chunks(ROWS * width));
    y.par_chunks_mut(ROWS * width).zip(scales.par_chunks_mut(ROWS)).zip(inputs).for_each(
        |((y, scales), (x, residual))| {
            vectorised!({
                let inputs = x.chunks_exact(width).zip(residual.chunks_exact(width));
                for ((y, scale), (x, residual)) in y.chunks_exact_mut(width).zip(scales).zip(inputs) {
                    y.iter_mut().zip(x).zip(residual).for_each(|((y, x), r)| *y = x + r);
                    let mean = sum(y, |y| y) / width as f32;
                    y.iter_mut().for_each(|y| *y -= mean);
                    let variance = sum(y, |y| y * y) / width as f32;
                    *scale = 1.0 / (variance + epsilon).sqrt();
                    let scale = *scale;
                    y.iter_mut().zip(gamma).zip(beta).for_each(|((y, g), b)| *y = *y * scale * g + b);
                }
            });
        },
    );
    (y, scales)
}

#[derive(Clone, Debug)]
struct Norm {
    x: Values,
    residual: Values,
    gamma: Values,
    scales: Vec<f32>,
    shape: [usize; 3],
}

impl Gradient<4> for Norm {
    fn gradients(&self, output: &[f32], _: [bool; 4]) -> [(Vec<f32>, Vec<usize>); 4] {
        let width = self.gamma.len();
        let mut dx = vec![0.0f32; self.x.len()];
        let inputs = self.x.par_chunks(ROWS * width).zip(self.residual.par_chunks(ROWS * width));
        let sums: Vec<(Vec<f32>, Vec<f32>)> = dx
            .par_chunks_mut(ROWS * width)
            .zip(self.scales.par_chunks(ROWS))
            .zip(inputs.zip(output.par_chunks(ROWS * width)))
            .map(|((dx, scales), ((x, residual), dy))| {
                let (mut d_gamma, mut d_beta) = (vec![0.0f32; width], vec![0.0f32; width]);
                let mut normal = vec![0.0f32; width];
                vectorised!({
                    let inputs = x.chunks_exact(width).zip(residual.chunks_exact(width));
                    let rows = dx.chunks_exact_mut(width).zip(dy.chunks_exact(width)).zip(scales);
                    for (((dx, dy), &scale), (x, residual)) in rows.zip(inputs) {
                        normal.iter_mut().zip(x).zip(residual).for_each(|((n, x), r)| *n = x + r);
                        let mean = sum(&normal, |n| n) / width as f32;
                        normal.iter_mut().for_each(|n| *n = (*n - mean) * scale);
                        d_gamma.iter_mut().zip(dy).zip(&normal).for_each(|((d, dy), n)| *d += dy * n);
                        d_beta.iter_mut().zip(dy).for_each(|(d, dy)| *d += dy);
                        dx.iter_mut().zip(dy).zip(&*self.gamma).for_each(|((d, dy), g)| *d = dy * g);
                        let shift = sum(dx, |d| d) / width as f32;
                        let slope = dot(dx, &normal) / width as f32;
                        dx.iter_mut().zip(&normal).for_each(|(d, n)| *d = (*d - shift - n * slope) * scale);
                    }
                });
                (d_gamma, d_beta)
            })
            .collect();
        let [d_gamma, d_beta] = merged(sums, width, width);
        let shape = self.shape.to_vec();
        [(dx.clone(), shape.clone()), (dx, shape), (d_gamma, vec![width]), (d_beta, vec![width])]
    }
}
