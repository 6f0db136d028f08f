//! What a transformer layer does to each of its tokens, on a few rows that stay in the nearest caches meanwhile.

use burn::nn::{LayerNorm, Linear};
use rayon::prelude::*;
use unopose_core::simd::{PANEL, map_rows, sum, vectorised};

use super::{super::TokenMaps, tape::Values};

/// A linear map in host memory.
pub struct Map {
    weight: Values,
    bias: Values,
}

impl Map {
    pub fn of(map: &Linear) -> Option<Self> {
        Some(Self { weight: Values::of(&map.weight.val())?, bias: Values::of(&map.bias.as_ref()?.val())? })
    }

    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    pub fn inputs(&self) -> usize {
        self.weight.len() / self.bias.len().max(1)
    }

    /// `[inputs, outputs]`.
    pub fn weight(&self) -> &[f32] {
        &self.weight
    }

    pub fn bias(&self) -> &[f32] {
        &self.bias
    }

    /// `x W + b`, `[R, inputs] -> [R, outputs]`.
    pub fn apply(&self, x: &[f32]) -> Vec<f32> {
        self.apply_with(&self.weight, x, false)
    }

    /// `relu(x W + b)`.
    pub fn apply_rectified(&self, x: &[f32]) -> Vec<f32> {
        self.apply_with(&self.weight, x, true)
    }

    /// `x weight + b` with other weights of any number of inputs.
    pub fn apply_with(&self, weight: &[f32], x: &[f32], rectify: bool) -> Vec<f32> {
        let inputs = weight.len() / self.outputs().max(1);
        let mut y = vec![0.0f32; x.len() / inputs.max(1) * self.outputs()];
        map_rows(&mut y, x, weight, &self.bias, rectify);
        y
    }

    /// [`Self::apply`] into `y`.
    pub fn write(&self, y: &mut [f32], x: &[f32]) {
        map_rows(y, x, &self.weight, &self.bias, false);
    }

    /// [`Self::apply`] for the outputs from `first` on, as many as `y` `[R, outputs]` has.
    pub fn write_columns(&self, y: &mut [f32], x: &[f32], first: usize) {
        let width = y.len() / (x.len() / self.inputs().max(1)).max(1);
        let weight = columns(&self.weight, self.outputs(), first, width);
        map_rows(y, x, &weight, &self.bias[first..first + width], false);
    }
}

/// A layer norm in host memory.
pub struct Norm {
    gamma: Values,
    beta: Values,
    epsilon: f32,
}

impl Norm {
    pub fn of(norm: &LayerNorm, epsilon: f64) -> Option<Self> {
        let (gamma, beta) = (Values::of(&norm.gamma.val())?, Values::of(&norm.beta.as_ref()?.val())?);
        Some(Self { gamma, beta, epsilon: epsilon as f32 })
    }

    pub fn width(&self) -> usize {
        self.gamma.len()
    }

    /// `norm(x + residual)` in the place of `x`, `[R, C]`.
    pub fn apply(&self, x: &mut [f32], residual: &[f32]) {
        let width = self.width();
        let (gamma, beta): (&[f32], &[f32]) = (&self.gamma, &self.beta);
        vectorised!({
            for (x, residual) in x.chunks_exact_mut(width).zip(residual.chunks_exact(width)) {
                x.iter_mut().zip(residual).for_each(|(x, r)| *x += r);
                let [mean, scale] = self.moments(x);
                let channels = x.iter_mut().zip(gamma).zip(beta);
                channels.for_each(|((x, g), b)| *x = (*x - mean) * scale * g + b);
            }
        });
    }

    /// Mean of a row, and what its distances from it are multiplied by.
    #[inline(always)]
    pub fn moments(&self, x: &[f32]) -> [f32; 2] {
        let width = x.len() as f32;
        let mean = sum(x, |x| x) / width;
        [mean, 1.0 / (sum(x, |x| (x - mean) * (x - mean)) / width + self.epsilon).sqrt()]
    }

    /// The columns of `norm(x)` from `first` on, `[R, PANEL]`, from rows `[R, C]` and their [`Self::moments`].
    pub fn panel(&self, x: &[f32], moments: &[[f32; 2]], first: usize) -> Vec<f32> {
        let [gamma, beta] = [&self.gamma, &self.beta].map(|values| &values[first..][..PANEL]);
        let mut panel = vec![0.0f32; moments.len() * PANEL];
        vectorised!({
            let rows = panel.chunks_exact_mut(PANEL).zip(x.chunks_exact(self.width())).zip(moments);
            for ((y, x), [mean, scale]) in rows {
                let channels = x[first..].iter().zip(gamma).zip(beta);
                y.iter_mut().zip(channels).for_each(|(y, ((x, g), b))| *y = (x - mean) * scale * g + b);
            }
        });
        panel
    }
}

/// [`TokenMaps`] in host memory.
pub(super) struct Tail {
    pub linear: Map,
    norm: Norm,
    expand: Map,
    squeeze: Map,
    output_norm: Norm,
}

impl Tail {
    pub fn of(maps: &TokenMaps) -> Option<Self> {
        Some(Self {
            linear: Map::of(maps.linear)?,
            norm: Norm::of(maps.norm, maps.epsilon)?,
            expand: Map::of(maps.expand)?,
            squeeze: Map::of(maps.squeeze)?,
            output_norm: Norm::of(maps.output_norm, maps.epsilon)?,
        })
    }

    /// Tokens after the layer, from what they were and what they read: `[R, C]` each.
    pub fn write(&self, out: &mut [f32], x: &[f32], read: &[f32]) {
        self.write_projected(out, x, self.linear.apply(read));
    }

    /// [`Self::write`] from what the output projection makes of what they read.
    pub fn write_projected(&self, out: &mut [f32], x: &[f32], mut attended: Vec<f32>) {
        self.norm.apply(&mut attended, x);
        let hidden = self.expand.apply_rectified(&attended);
        self.squeeze.write(out, &hidden);
        self.output_norm.apply(out, &attended);
    }
}

/// Part `[R, width]` of the columns from `first` on.
pub(super) fn columns(rows: &[f32], of: usize, first: usize, width: usize) -> Vec<f32> {
    let mut part = vec![0.0f32; rows.len() / of * width];
    for (part, row) in part.chunks_exact_mut(width).zip(rows.chunks_exact(of)) {
        part.copy_from_slice(&row[first..first + width]);
    }
    part
}

/// What each head of each item has for its tokens, `[T, d]` each, side by side: `[B, T, H d]`. `d` channels of the first
/// `tokens` rows are taken.
pub(super) fn merged_heads(parts: &[Vec<f32>], heads: usize, tokens: usize, d: usize) -> Vec<f32> {
    let mut out = vec![0.0f32; parts.len() * tokens * d];
    out.par_chunks_exact_mut((tokens * heads * d).max(1)).zip(parts.par_chunks(heads)).for_each(
        |(out, parts)| {
            for (t, row) in out.chunks_exact_mut(heads * d).enumerate() {
                for (out, part) in row.chunks_exact_mut(d).zip(parts) {
                    out.copy_from_slice(&part[t * d..][..d]);
                }
            }
        },
    );
    out
}

/// `[R, C] -> [C, R]`.
pub(super) fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    let rows = values.len() / columns.max(1);
    let mut out = vec![0.0f32; values.len()];
    // A line of the cache at a time on both sides.
    const LINE: usize = 16;
    for (block, values) in values.chunks(LINE * columns).enumerate() {
        for c in 0..columns {
            let column = values.iter().skip(c).step_by(columns);
            out[c * rows + block * LINE..].iter_mut().zip(column).for_each(|(o, v)| *o = *v);
        }
    }
    out
}
