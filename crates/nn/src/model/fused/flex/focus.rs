//! The feature map of the focused linear attention, forth and back in one pass each.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{dot, vectorised};

use super::{
    linear_relu::merged,
    tape::{Gradient, Input, Values, plain, record},
};

/// Rows per parallel task; fixed, so that sums over rows do not depend on the number of threads.
const ROWS: usize = 64;

pub fn focus_cubed(x: &Tensor<3>, scale: &Tensor<3>, epsilon: f32) -> Option<Tensor<3>> {
    let shape = x.dims();
    if let (Some(x), Some(scale)) = (Values::of(x), Values::of(scale)) {
        return Some(plain(forward(&x, &scale, epsilon), shape));
    }
    let inputs = [Input::of(x)?, Input::of(scale)?];
    let y = forward(&inputs[0].values, &inputs[1].values, epsilon);
    record(inputs, y, shape, |[x, scale], _| Focus { x, scale, epsilon, shape })
}

fn forward(x: &[f32], scale: &[f32], epsilon: f32) -> Vec<f32> {
    let width = scale.len();
    let mut out = vec![0.0f32; x.len()];
    out.par_chunks_mut(ROWS * width)
        .zip(x.par_chunks(ROWS * width))
        .for_each(|(out, x)| focus_rows(out, x, scale, epsilon));
    out
}

/// The feature map of a few rows.
pub(super) fn focus_rows(out: &mut [f32], x: &[f32], scale: &[f32], epsilon: f32) {
    let width = scale.len();
    let mut base = vec![0.0f32; width];
    vectorised!({
        for (out, x) in out.chunks_exact_mut(width).zip(x.chunks_exact(width)) {
            let [before, after] = cube(&mut base, out, x, scale, epsilon);
            let ratio = before / after;
            out.iter_mut().for_each(|o| *o *= ratio);
        }
    });
}

/// `y` and its cubes; the norms of both.
#[inline(always)]
fn cube(y: &mut [f32], cubes: &mut [f32], x: &[f32], scale: &[f32], epsilon: f32) -> [f32; 2] {
    for ((y, &x), &s) in y.iter_mut().zip(x).zip(scale) {
        // NaN stays.
        *y = (if x <= 0.0 { 0.0 } else { x } + epsilon) / s;
    }
    cubes.iter_mut().zip(&*y).for_each(|(c, &y)| *c = y * y * y);
    [dot(y, y).sqrt(), dot(cubes, cubes).sqrt()]
}

#[derive(Clone, Debug)]
struct Focus {
    x: Values,
    scale: Values,
    epsilon: f32,
    shape: [usize; 3],
}

impl Gradient<2> for Focus {
    /// With `c = y^3`, `r = |y| / |c|` and `G = sum g c`: `dy = 3 y^2 r g + G (y / (|y| |c|) - 3 |y| y^5 / |c|^3)`.
    fn gradients(&self, output: &[f32], _: [bool; 2]) -> [(Vec<f32>, Vec<usize>); 2] {
        let width = self.scale.len();
        let mut dx = vec![0.0f32; self.x.len()];
        let sums: Vec<(Vec<f32>, Vec<f32>)> = dx
            .par_chunks_mut(ROWS * width)
            .zip(self.x.par_chunks(ROWS * width).zip(output.par_chunks(ROWS * width)))
            .map(|(dx, (x, g))| {
                let mut d_scale = vec![0.0f32; width];
                let (mut y, mut c) = (vec![0.0f32; width], vec![0.0f32; width]);
                vectorised!({
                    let rows = x.chunks_exact(width).zip(g.chunks_exact(width));
                    for (dx, (x, g)) in dx.chunks_exact_mut(width).zip(rows) {
                        let [before, after] = cube(&mut y, &mut c, x, &self.scale, self.epsilon);
                        let ratio = before / after;
                        let sum = dot(g, &c);
                        let (up, down) = (sum / (before * after), 3.0 * sum * ratio / (after * after));
                        let rows = dx.iter_mut().zip(&mut d_scale).zip(&*self.scale);
                        for ((((dx, ds), &s), (&x, &g)), (&y, &c)) in
                            rows.zip(x.iter().zip(g)).zip(y.iter().zip(&c))
                        {
                            let dy = 3.0 * y * y * (ratio * g) + up * y - down * c * y * y;
                            *ds -= dy * y / s;
                            *dx = if x <= 0.0 { 0.0 } else { dy / s };
                        }
                    }
                });
                (d_scale, Vec::new())
            })
            .collect();
        let [d_scale, _] = merged(sums, width, 0);
        [(dx, self.shape.to_vec()), (d_scale, vec![1, 1, width])]
    }
}
