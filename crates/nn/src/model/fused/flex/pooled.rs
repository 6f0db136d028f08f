//! Shared layers followed by the maximum over each group of rows.
//!
//! The maximum's gradient reaches one row per group and channel only, so the last layer's backward pass costs as much
//! as one row of each group, and its output is never stored.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{map_rows, vectorised};

use super::{
    BLOCK,
    linear_relu::{merged, transpose},
    tape::{Gradient, Input, Values, plain, record},
};

pub fn linear_relu_max(
    x: &Tensor<2>,
    weight: &Tensor<2>,
    shift: &Tensor<1>,
    group: usize,
) -> Option<Tensor<2>> {
    let [rows, inner] = x.dims();
    let [_, columns] = weight.dims();
    let groups = rows / group.max(1);
    if let (Some(x), Some(w), Some(s)) = (Values::of(x), Values::of(weight), Values::of(shift)) {
        return Some(plain(forward(&x, &w, &s, inner, group).0, [groups, columns]));
    }
    let inputs = [Input::of(x)?, Input::of(weight)?, Input::of(shift)?];
    let [x, w, s] = &inputs;
    let (y, winners) = forward(&x.values, &w.values, &s.values, inner, group);
    record(inputs, y, [groups, columns], |[x, weight, _], y| LinearReluMax {
        x,
        weight,
        y: y.clone(),
        winners,
        inner,
        columns,
    })
}

/// Maxima, and the row of `x` behind each.
fn forward(x: &[f32], weight: &[f32], shift: &[f32], inner: usize, group: usize) -> (Vec<f32>, Vec<u32>) {
    let columns = shift.len();
    let groups = x.len() / (inner * group).max(1);
    let (mut maxima, mut winners) = (vec![0.0f32; groups * columns], vec![0u32; groups * columns]);
    let per_task = BLOCK.div_ceil(group.max(1));
    maxima
        .par_chunks_mut(per_task * columns)
        .zip(winners.par_chunks_mut(per_task * columns))
        .zip(x.par_chunks(per_task * group * inner))
        .enumerate()
        .for_each_init(
            || vec![0.0f32; per_task * group * columns],
            |y, (task, ((maxima, winners), x))| {
                let y = &mut y[..x.len() / inner * columns];
                map_rows(y, x, weight, shift, true);
                let rows = maxima.chunks_exact_mut(columns).zip(winners.chunks_exact_mut(columns));
                for (g, ((maxima, winners), y)) in rows.zip(y.chunks_exact(group * columns)).enumerate() {
                    let first = ((task * per_task + g) * group) as u32;
                    vectorised!(largest_with_row(maxima, winners, y, first));
                }
            },
        );
    (maxima, winners)
}

/// Column maxima of `y` and their rows, counted from `first`; the first of equal ones.
#[inline(always)]
fn largest_with_row(maxima: &mut [f32], winners: &mut [u32], y: &[f32], first: u32) {
    maxima.fill(f32::NEG_INFINITY);
    for (row, y) in (first..).zip(y.chunks_exact(maxima.len())) {
        for ((best, winner), &y) in maxima.iter_mut().zip(winners.iter_mut()).zip(y) {
            // NaN wins.
            let better = y > *best || y.is_nan();
            *best = if better { y } else { *best };
            *winner = if better { row } else { *winner };
        }
    }
}

#[derive(Clone, Debug)]
struct LinearReluMax {
    x: Values,
    weight: Values,
    y: Values,
    winners: Vec<u32>,
    inner: usize,
    columns: usize,
}

impl Gradient<3> for LinearReluMax {
    fn gradients(&self, output: &[f32], wanted: [bool; 3]) -> [(Vec<f32>, Vec<usize>); 3] {
        let Self { inner, columns, .. } = *self;
        let (rows, groups) = (self.x.len() / inner, self.y.len() / columns.max(1));
        let group = rows / groups.max(1);
        let transposed = transpose(&self.weight, columns);
        let per_task = BLOCK.div_ceil(group.max(1));
        let mut dx = vec![0.0; self.x.len()];
        let sums: Vec<(Vec<f32>, Vec<f32>)> = dx
            .par_chunks_mut(per_task * group * inner)
            .zip(self.y.par_chunks(per_task * columns).zip(output.par_chunks(per_task * columns)))
            .zip(self.winners.par_chunks(per_task * columns))
            .enumerate()
            .map(|(task, ((dx, (y, dy)), winners))| {
                let first = task * per_task * group;
                let (mut dw, mut ds) = (vec![0.0; columns * inner], vec![0.0; columns]);
                vectorised!({
                    for (i, ((&y, &dy), &winner)) in y.iter().zip(dy).zip(winners).enumerate() {
                        if y <= 0.0 || dy == 0.0 {
                            continue;
                        }
                        let (c, row) = (i % columns, winner as usize);
                        let x = &self.x[row * inner..(row + 1) * inner];
                        dw[c * inner..(c + 1) * inner].iter_mut().zip(x).for_each(|(w, x)| *w += dy * x);
                        let dx = &mut dx[(row - first) * inner..][..inner];
                        let w = &transposed[c * inner..(c + 1) * inner];
                        dx.iter_mut().zip(w).for_each(|(d, w)| *d += dy * w);
                        ds[c] += dy;
                    }
                });
                (dw, ds)
            })
            .collect();
        let [dw, ds] = merged(sums, columns * inner, columns);
        let dx = if wanted[0] { dx } else { Vec::new() };
        [(dx, vec![rows, inner]), (transpose(&dw, inner), vec![inner, columns]), (ds, vec![columns])]
    }
}

pub fn shared_layers_max(
    x: &Tensor<2>,
    layers: &[(Tensor<2>, Tensor<1>)],
    group: usize,
    counts: &[u32],
) -> Option<Tensor<2>> {
    let [rows, inner] = x.dims();
    let x = Values::of(x)?;
    let layers: Vec<(Values, Values)> =
        layers.iter().map(|(w, s)| Some((Values::of(w)?, Values::of(s)?))).collect::<Option<_>>()?;
    let layers: Vec<(&[f32], &[f32])> = layers.iter().map(|(w, s)| -> (&[f32], &[f32]) { (w, s) }).collect();
    let columns = layers.last()?.1.len();
    let mut maxima = vec![0.0f32; rows / group.max(1) * columns];
    maxima
        .par_chunks_mut(columns)
        .zip(x.par_chunks(group * inner))
        .zip(counts)
        .with_min_len(16)
        .for_each_init(
            || layers.iter().map(|(_, s)| vec![0.0f32; group * s.len()]).collect::<Vec<_>>(),
            |hidden, ((maxima, x), &count)| {
                // A group without neighbours is its padding.
                let rows = (count as usize).clamp(1, group);
                let mut width = inner;
                for (index, &(weight, shift)) in layers.iter().enumerate() {
                    let (before, rest) = hidden.split_at_mut(index);
                    let x = before.last().map_or(x, Vec::as_slice);
                    let y = &mut rest[0][..rows * shift.len()];
                    map_rows(y, &x[..rows * width], weight, shift, true);
                    width = shift.len();
                }
                let y = hidden.last().map_or(&[][..], |y| &y[..rows * columns]);
                vectorised!({
                    for y in y.chunks_exact(columns) {
                        maxima.iter_mut().zip(y).for_each(|(m, &y)| *m = if y <= *m { *m } else { y });
                    }
                });
            },
        );
    Some(plain(maxima, [rows / group.max(1), columns]))
}
