//! What a transformer layer does to each of its tokens, on a few rows that stay in the nearest caches meanwhile.

use burn::nn::{LayerNorm, Linear};

use super::{TokenMaps, tape::Values};
use crate::simd::{add_product, sum, vectorised};

/// A linear map in host memory.
pub(super) struct Map {
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
        let mut y = vec![0.0f32; x.len() / self.inputs().max(1) * self.outputs()];
        self.write(&mut y, x);
        y
    }

    /// [`Self::apply`] for the outputs from `first` on, as many as `y` `[R, outputs]` has.
    pub fn write_columns(&self, y: &mut [f32], x: &[f32], first: usize) {
        let width = y.len() / (x.len() / self.inputs().max(1)).max(1);
        let bias = &self.bias[first..first + width];
        y.chunks_exact_mut(width.max(1)).for_each(|row| row.copy_from_slice(bias));
        add_product(y, x, &columns(&self.weight, self.outputs(), first, width), self.inputs());
    }

    /// [`Self::apply`] into `y`.
    pub fn write(&self, y: &mut [f32], x: &[f32]) {
        y.chunks_exact_mut(self.outputs().max(1)).for_each(|row| row.copy_from_slice(&self.bias));
        add_product(y, x, &self.weight, self.inputs());
    }
}

/// A layer norm in host memory.
pub(super) struct Norm {
    gamma: Values,
    beta: Values,
    epsilon: f32,
}

impl Norm {
    pub fn of(norm: &LayerNorm, epsilon: f64) -> Option<Self> {
        let (gamma, beta) = (Values::of(&norm.gamma.val())?, Values::of(&norm.beta.as_ref()?.val())?);
        Some(Self { gamma, beta, epsilon: epsilon as f32 })
    }

    /// `norm(x + residual)` in the place of `x`, `[R, C]`.
    pub fn apply(&self, x: &mut [f32], residual: &[f32]) {
        let width = self.gamma.len();
        vectorised(|| {
            for (x, residual) in x.chunks_exact_mut(width).zip(residual.chunks_exact(width)) {
                x.iter_mut().zip(residual).for_each(|(x, r)| *x += r);
                self.normalise(x);
            }
        });
    }

    /// `norm(x)` of a row in its place.
    #[inline(always)]
    pub fn normalise(&self, x: &mut [f32]) {
        let width = x.len() as f32;
        let mean = sum(x, |x| x) / width;
        x.iter_mut().for_each(|x| *x -= mean);
        let scale = 1.0 / (sum(x, |x| x * x) / width + self.epsilon).sqrt();
        let channels = x.iter_mut().zip(&*self.gamma).zip(&*self.beta);
        channels.for_each(|((x, g), b)| *x = *x * scale * g + b);
    }
}

/// [`TokenMaps`] in host memory.
pub(super) struct Tail {
    linear: Map,
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
        let mut attended = self.linear.apply(read);
        self.norm.apply(&mut attended, x);
        let mut hidden = self.expand.apply(&attended);
        // NaN stays.
        vectorised(|| hidden.iter_mut().for_each(|y| *y = if *y <= 0.0 { 0.0 } else { *y }));
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
