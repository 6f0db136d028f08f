//! `relu(x W + s)` and its gradient in one pass each.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, add_transposed_product, map_rows, vectorised};

use super::{
    BLOCK,
    tape::{Gradient, Input, Values, plain, record},
};

pub fn linear_relu(x: &Tensor<2>, weight: &Tensor<2>, shift: &Tensor<1>) -> Option<Tensor<2>> {
    let [rows, inner] = x.dims();
    let [_, columns] = weight.dims();
    if let (Some(x), Some(w), Some(s)) = (Values::of(x), Values::of(weight), Values::of(shift)) {
        return Some(plain(forward(&x, &w, &s, inner), [rows, columns]));
    }
    let inputs = [Input::of(x)?, Input::of(weight)?, Input::of(shift)?];
    let [x, w, s] = &inputs;
    let y = forward(&x.values, &w.values, &s.values, inner);
    record(inputs, y, [rows, columns], |[x, weight, _], y| LinearRelu {
        x,
        weight,
        y: y.clone(),
        inner,
        columns,
    })
}

fn forward(x: &[f32], weight: &[f32], shift: &[f32], inner: usize) -> Vec<f32> {
    let columns = shift.len();
    let mut y = vec![0.0; x.len() / inner * columns];
    y.par_chunks_mut(BLOCK * columns)
        .zip(x.par_chunks(BLOCK * inner))
        .for_each(|(y, x)| map_rows(y, x, weight, shift, true));
    y
}

#[derive(Clone, Debug)]
struct LinearRelu {
    x: Values,
    weight: Values,
    y: Values,
    inner: usize,
    columns: usize,
}

impl Gradient<3> for LinearRelu {
    fn gradients(&self, output: &[f32], wanted: [bool; 3]) -> [(Vec<f32>, Vec<usize>); 3] {
        let Self { inner, columns, .. } = *self;
        let rows = self.x.len() / inner;
        let transposed = transpose(&self.weight, columns);
        let mut dx = vec![0.0; if wanted[0] { self.x.len() } else { 0 }];
        let mut dx_blocks = dx.par_chunks_mut(BLOCK * inner).map(Some).collect::<Vec<_>>();
        dx_blocks.resize_with(rows.div_ceil(BLOCK), || None);
        let sums: Vec<(Vec<f32>, Vec<f32>)> = dx_blocks
            .into_par_iter()
            .zip(self.x.par_chunks(BLOCK * inner))
            .zip(self.y.par_chunks(BLOCK * columns).zip(output.par_chunks(BLOCK * columns)))
            .map(|((dx, x), (y, dy))| {
                let mut dz = dy.to_vec();
                vectorised!(dz.iter_mut().zip(y).for_each(|(d, y)| *d = if *y <= 0.0 { 0.0 } else { *d }));
                if let Some(dx) = dx {
                    add_product(dx, &dz, &transposed, columns);
                }
                let mut dw = vec![0.0; inner * columns];
                add_transposed_product(&mut dw, x, &dz, x.len() / inner);
                (dw, column_sums(&dz, columns))
            })
            .collect();
        let [dw, ds] = merged(sums, inner * columns, columns);
        [(dx, vec![rows, inner]), (dw, vec![inner, columns]), (ds, vec![columns])]
    }
}

/// `[R, C] -> [C, R]`.
pub(super) fn transpose(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|c| values.iter().skip(c).step_by(columns).copied()).collect()
}

pub(super) fn column_sums(values: &[f32], columns: usize) -> Vec<f32> {
    let mut sums = vec![0.0; columns];
    vectorised!({
        for row in values.chunks_exact(columns) {
            sums.iter_mut().zip(row).for_each(|(s, v)| *s += v);
        }
    });
    sums
}

/// Sums of the blocks' results, in their order.
pub(super) fn merged(blocks: Vec<(Vec<f32>, Vec<f32>)>, first: usize, second: usize) -> [Vec<f32>; 2] {
    let mut total = [vec![0.0; first], vec![0.0; second]];
    for (a, b) in blocks {
        total[0].iter_mut().zip(a).for_each(|(t, v)| *t += v);
        total[1].iter_mut().zip(b).for_each(|(t, v)| *t += v);
    }
    total
}
