//! Linear maps of many columns, by panels of them.

use std::ops::Range;

use burn::{nn::Linear, tensor::Tensor};
use rayon::prelude::*;
use unopose_core::simd::{PANEL, add_panel, panels_of_rows, vectorised};

use super::{
    rows::{Map, Norm},
    tape::{Values, plain},
};

/// Rows per parallel task.
const ROWS: usize = 8;
/// Panels of the left matrix that all panels of the result are computed from before the next ones: with the two thousand
/// rows of eight images these are six megabytes, which stay in the cache that the cores share.
const DEPTH: usize = 12;

/// `end(x W + b)`, `x` and the result by panels `[R, PANEL]`; `None` for sizes that are no multiples of [`PANEL`].
pub fn mapped(x: &[Vec<f32>], map: &Map, end: impl Fn(&mut [f32]) + Sync) -> Option<Vec<Vec<f32>>> {
    some_mapped(x, map, 0..map.outputs() / PANEL, end)
}

/// Some of the panels of [`mapped`].
pub fn some_mapped(
    x: &[Vec<f32>],
    map: &Map,
    which: Range<usize>,
    end: impl Fn(&mut [f32]) + Sync,
) -> Option<Vec<Vec<f32>>> {
    if x.len() * PANEL != map.inputs() || !map.outputs().is_multiple_of(PANEL) {
        return None;
    }
    let values = x.first().map_or(0, Vec::len);
    let mut panels: Vec<Vec<f32>> = which.clone().map(|_| Vec::new()).collect();
    for (index, (x, weight)) in
        x.chunks(DEPTH).zip(map.weight().chunks(DEPTH * PANEL * map.outputs())).enumerate()
    {
        let last = (index + 1) * DEPTH * PANEL >= map.inputs();
        panels.par_iter_mut().zip(which.clone()).for_each(|(panel, which)| {
            if index == 0 {
                let bias = &map.bias()[which * PANEL..][..PANEL];
                panel.reserve_exact(values);
                (0..values / PANEL).for_each(|_| panel.extend_from_slice(bias));
            }
            add_panel(panel, x, weight, which * PANEL);
            if last {
                end(panel);
            }
        });
    }
    Some(panels)
}

/// `norm(x)` of `[R, C]` by panels; `None` when the width is not a multiple of [`PANEL`].
pub fn normalised(x: &[f32], norm: &Norm) -> Option<Vec<Vec<f32>>> {
    let width = norm.width();
    let mut moments = vec![[0.0f32; 2]; x.len() / width];
    moments.par_chunks_mut(ROWS).zip(x.par_chunks(ROWS * width)).for_each(|(moments, x)| {
        vectorised!(moments.iter_mut().zip(x.chunks_exact(width)).for_each(|(m, x)| *m = norm.moments(x)));
    });
    let panels = (0..width).into_par_iter().step_by(PANEL).map(|first| norm.panel(x, &moments, first));
    width.is_multiple_of(PANEL).then(|| panels.collect())
}

/// `x + gamma y` with `y` by panels, `[R, C]`.
pub fn onto(x: &[f32], panels: &[Vec<f32>], gamma: &[f32]) -> Vec<f32> {
    let width = panels.len() * PANEL;
    let mut sum = vec![0.0f32; x.len()];
    sum.par_chunks_mut(ROWS * width).zip(x.par_chunks(ROWS * width)).enumerate().for_each(
        |(task, (sum, x))| {
            vectorised!({
                let rows = sum.chunks_exact_mut(width).zip(x.chunks_exact(width));
                for (row, (sum, x)) in (task * ROWS..).zip(rows) {
                    let channels = sum.chunks_exact_mut(PANEL).zip(x.chunks_exact(PANEL));
                    for ((sum, x), (panel, gamma)) in channels.zip(panels.iter().zip(gamma.chunks(PANEL))) {
                        let y = &panel[row * PANEL..][..PANEL];
                        sum.iter_mut().zip(x).zip(y).zip(gamma).for_each(|(((s, x), y), g)| *s = x + g * y);
                    }
                }
            });
        },
    );
    sum
}

/// Sums of four weighted rows of `x W + b`, whose columns hold the rows of `width` one after the other.
pub fn sampled_linear(
    x: &Tensor<2>,
    map: &Linear,
    width: usize,
    rows: &[i32],
    weights: &[f32],
) -> Option<Tensor<2>> {
    let (map, values) = (Map::of(map)?, Values::of(x)?);
    if width == 0 || !width.is_multiple_of(PANEL) {
        return None;
    }
    let panels = mapped(&panels_of_rows(&values, x.dims()[1])?, &map, |_| {})?;
    let cells = map.outputs() / width;
    let mut out = vec![0.0f32; rows.len() / 4 * width];
    let taps = rows.par_chunks_exact(4).zip(weights.par_chunks_exact(4));
    out.par_chunks_exact_mut(width).zip(taps).with_min_len(ROWS).for_each(|(out, (rows, weights))| {
        vectorised!({
            for (&row, &weight) in rows.iter().zip(weights) {
                let (row, cell) = (row as usize / cells, row as usize % cells);
                let panels = &panels[cell * width / PANEL..];
                for (out, panel) in out.chunks_exact_mut(PANEL).zip(panels) {
                    let values = &panel[row * PANEL..][..PANEL];
                    out.iter_mut().zip(values).for_each(|(o, v)| *o += weight * v);
                }
            }
        });
    });
    Some(plain(out, [rows.len() / 4, width]))
}
