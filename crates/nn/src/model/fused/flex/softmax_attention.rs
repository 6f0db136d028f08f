//! Softmax attention of the matching transformers and its gradient, head by head.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, add_transposed_product, dot, vectorised};

use super::{
    rows::{columns, merged_heads, transposed},
    self_attention::{exponentials, largest},
    tape::{Gradient, Input, Values, plain, record},
};

/// Rows of scores are padded to whole vectors.
const LANES: usize = 16;

pub fn softmax_attention(
    [q, k, v]: [&Tensor<3>; 3],
    position: Option<&Tensor<4>>,
    heads: usize,
) -> Option<Tensor<3>> {
    let ([batch, n, width], m) = (q.dims(), k.dims()[1]);
    let sizes = Sizes { batch, heads, n, m, d: width / heads };
    if let (Some(q), Some(k), Some(v)) = (Values::of(q), Values::of(k), Values::of(v)) {
        let position = match position {
            Some(position) => Some(Values::of(position)?),
            None => None,
        };
        let (read, _) = sizes.forward([&q, &k, &v], position.as_deref());
        return Some(plain(read, [batch, n, width]));
    }
    let inputs = [Input::of(q)?, Input::of(k)?, Input::of(v)?];
    let position = match position {
        Some(position) => Some(Input::of(position)?),
        None => None,
    };
    let values = [&*inputs[0].values, &*inputs[1].values, &*inputs[2].values];
    let (read, weights) = sizes.forward(values, position.as_ref().map(|position| &*position.values));
    let attention = |q, k, v| Attention { q, k, v, weights, sizes };
    let shape = [batch, n, width];
    match position {
        None => record(inputs, read, shape, |[q, k, v], _| attention(q, k, v)),
        Some(position) => {
            let [q, k, v] = inputs;
            record([q, k, v, position], read, shape, |[q, k, v, _], _| attention(q, k, v))
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Sizes {
    batch: usize,
    heads: usize,
    /// Queries, then keys and values.
    n: usize,
    m: usize,
    /// Channels of a head.
    d: usize,
}

impl Sizes {
    fn padded(&self) -> usize {
        self.m.next_multiple_of(LANES)
    }

    /// A head's channels of `[B, rows, C]`, padded with zeros to as many rows: `[padded, d]`.
    fn of_head(&self, values: &[f32], item: usize, padded: usize) -> Vec<f32> {
        let per_pair = values.len() / self.batch;
        let pair = &values[item / self.heads * per_pair..][..per_pair];
        let mut rows = columns(pair, self.heads * self.d, item % self.heads * self.d, self.d);
        rows.resize(padded * self.d, 0.0);
        rows
    }

    /// [`Self::of_head`] of all items back to `[B, rows, C]`, without what is padded.
    fn merged(&self, parts: &[Vec<f32>], rows: usize) -> Vec<f32> {
        merged_heads(parts, self.heads, rows, self.d)
    }

    /// What queries read `[B, N, C]`, and the weights with which they read `[B H, N, padded]`.
    fn forward(&self, [q, k, v]: [&[f32]; 3], position: Option<&[f32]>) -> (Vec<f32>, Vec<f32>) {
        let Self { n, m, d, .. } = *self;
        let padded = self.padded();
        let mut weights = vec![0.0f32; self.batch * self.heads * n * padded];
        let read: Vec<Vec<f32>> = weights
            .par_chunks_exact_mut((n * padded).max(1))
            .enumerate()
            .map(|(item, weights)| {
                if let Some(position) = position {
                    let rows = position[item * n * m..][..n * m].chunks_exact(m);
                    weights.chunks_exact_mut(padded).zip(rows).for_each(|(w, p)| w[..m].copy_from_slice(p));
                }
                let keys = transposed(&self.of_head(k, item, padded), d);
                add_product(weights, &self.of_head(q, item, n), &keys, d);
                vectorised!({
                    for row in weights.chunks_exact_mut(padded) {
                        let row = &mut row[..m];
                        let largest = largest(row);
                        let scale = 1.0 / exponentials(row, largest);
                        row.iter_mut().for_each(|w| *w *= scale);
                    }
                });
                let mut read = vec![0.0f32; n * d];
                add_product(&mut read, weights, &self.of_head(v, item, padded), padded);
                read
            })
            .collect();
        (self.merged(&read, n), weights)
    }
}

#[derive(Clone, Debug)]
struct Attention {
    q: Values,
    k: Values,
    v: Values,
    weights: Vec<f32>,
    sizes: Sizes,
}

impl Attention {
    /// Gradients of queries, keys, values and, `[B, H, N, M]`, scores.
    fn all_gradients(&self, output: &[f32], of_scores: bool) -> [Vec<f32>; 4] {
        let Sizes { batch, heads, n, m, d } = self.sizes;
        let padded = self.sizes.padded();
        let mut to_scores = vec![0.0f32; if of_scores { batch * heads * n * m } else { 0 }];
        let mut by_item: Vec<&mut [f32]> = to_scores.chunks_exact_mut((n * m).max(1)).collect();
        by_item.resize_with(batch * heads, Default::default);
        let parts: Vec<[Vec<f32>; 3]> = by_item
            .into_par_iter()
            .zip(self.weights.par_chunks_exact((n * padded).max(1)))
            .enumerate()
            .map(|(item, (to_scores, weights))| {
                let of_head = |values: &[f32], rows: usize| self.sizes.of_head(values, item, rows);
                let to_read = of_head(output, n);
                let mut to_v = vec![0.0f32; padded * d];
                add_transposed_product(&mut to_v, weights, &to_read, n);
                let mut gradients = vec![0.0f32; n * padded];
                add_product(&mut gradients, &to_read, &transposed(&of_head(&self.v, padded), d), d);
                vectorised!({
                    for (g, w) in gradients.chunks_exact_mut(padded).zip(weights.chunks_exact(padded)) {
                        let mean = dot(g, w);
                        g.iter_mut().zip(w).for_each(|(g, w)| *g = w * (*g - mean));
                    }
                });
                let rows = to_scores.chunks_exact_mut(m).zip(gradients.chunks_exact(padded));
                rows.for_each(|(to, g)| to.copy_from_slice(&g[..m]));
                let (mut to_q, mut to_k) = (vec![0.0f32; n * d], vec![0.0f32; padded * d]);
                add_product(&mut to_q, &gradients, &of_head(&self.k, padded), padded);
                add_transposed_product(&mut to_k, &gradients, &of_head(&self.q, n), n);
                [to_q, to_k, to_v]
            })
            .collect();
        let (mut to_q, mut to_k, mut to_v) = (Vec::new(), Vec::new(), Vec::new());
        for [q, k, v] in parts {
            to_q.push(q);
            to_k.push(k);
            to_v.push(v);
        }
        let merged = |parts: &[Vec<f32>], rows: usize| self.sizes.merged(parts, rows);
        [merged(&to_q, n), merged(&to_k, m), merged(&to_v, m), to_scores]
    }

    fn shapes(&self) -> [Vec<usize>; 4] {
        let Sizes { batch, heads, n, m, d } = self.sizes;
        let of = |rows: usize| vec![batch, rows, heads * d];
        [of(n), of(m), of(m), vec![batch, heads, n, m]]
    }
}

impl Gradient<3> for Attention {
    fn gradients(&self, output: &[f32], _: [bool; 3]) -> [(Vec<f32>, Vec<usize>); 3] {
        let [q, k, v, _] = self.all_gradients(output, false);
        let [of_q, of_k, of_v, _] = self.shapes();
        [(q, of_q), (k, of_k), (v, of_v)]
    }
}

impl Gradient<4> for Attention {
    fn gradients(&self, output: &[f32], wanted: [bool; 4]) -> [(Vec<f32>, Vec<usize>); 4] {
        let [q, k, v, scores] = self.all_gradients(output, wanted[3]);
        let [of_q, of_k, of_v, of_scores] = self.shapes();
        [(q, of_q), (k, of_k), (v, of_v), (scores, of_scores)]
    }
}
