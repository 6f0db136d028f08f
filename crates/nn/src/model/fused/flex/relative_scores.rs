//! Scores of the relative positions: the structure embedding is read once for all heads.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{row_products, vectorised};

use super::tape::{Gradient, Input, Values, plain, record};

pub fn relative_scores(projected: &Tensor<4>, embedding: &Tensor<4>) -> Option<Tensor<4>> {
    let [batch, heads, n, width] = projected.dims();
    let sizes = Sizes { heads, n, m: embedding.dims()[2], width };
    let shape = [batch, heads, n, sizes.m];
    if let (Some(projected), Some(embedding)) = (Values::of(projected), Values::of(embedding)) {
        return Some(plain(sizes.scores(&projected, &embedding), shape));
    }
    let inputs = [Input::of(projected)?, Input::of(embedding)?];
    let scores = sizes.scores(&inputs[0].values, &inputs[1].values);
    record(inputs, scores, shape, |[projected, embedding], _| Scores { projected, embedding, sizes })
}

#[derive(Clone, Copy, Debug)]
struct Sizes {
    heads: usize,
    n: usize,
    m: usize,
    width: usize,
}

impl Sizes {
    /// Rows `[b, h, n]` of an array by `(b, n)`, which share the embedding's rows.
    fn by_point<'a>(&self, values: &'a mut [f32], width: usize) -> Vec<Vec<&'a mut [f32]>> {
        let Self { heads, n, .. } = *self;
        let points = values.len() / (heads * width).max(1);
        let mut rows: Vec<Vec<&mut [f32]>> = (0..points).map(|_| Vec::with_capacity(heads)).collect();
        for (row, values) in values.chunks_exact_mut(width.max(1)).enumerate() {
            rows[row / (heads * n) * n + row % n].push(values);
        }
        rows
    }

    /// Row `[b, h, n]` of each head for the point `(b, n)`.
    fn heads_of<'a>(&self, values: &'a [f32], width: usize, point: usize) -> Vec<&'a [f32]> {
        let Self { heads, n, .. } = *self;
        let (b, i) = (point / n, point % n);
        (0..heads).map(|h| &values[((b * heads + h) * n + i) * width..][..width]).collect()
    }

    fn scores(&self, projected: &[f32], embedding: &[f32]) -> Vec<f32> {
        let Self { m, width, .. } = *self;
        let mut scores = vec![0.0f32; projected.len() / width.max(1) * m];
        let rows =
            self.by_point(&mut scores, m).into_par_iter().zip(embedding.par_chunks_exact((m * width).max(1)));
        rows.enumerate().for_each(|(point, (mut scores, embedding))| {
            row_products(&mut scores, &self.heads_of(projected, width, point), embedding);
        });
        scores
    }
}

#[derive(Clone, Debug)]
struct Scores {
    projected: Values,
    embedding: Values,
    sizes: Sizes,
}

impl Gradient<2> for Scores {
    fn gradients(&self, output: &[f32], wanted: [bool; 2]) -> [(Vec<f32>, Vec<usize>); 2] {
        let Sizes { heads, n, m, width } = self.sizes;
        let batch = self.embedding.len() / (n * m * width).max(1);
        let mut to_projected = vec![0.0f32; self.projected.len()];
        let mut to_embedding = vec![0.0f32; if wanted[1] { self.embedding.len() } else { 0 }];
        let mut blocks: Vec<&mut [f32]> = to_embedding.chunks_exact_mut(m * width).collect();
        blocks.resize_with(batch * n, Default::default);
        let mut rows = self.sizes.by_point(&mut to_projected, width);
        rows.par_iter_mut().zip(blocks).zip(self.embedding.par_chunks_exact(m * width)).enumerate().for_each(
            |(point, ((rows, block), embedding))| {
                let gradients = self.sizes.heads_of(output, m, point);
                let queries = self.sizes.heads_of(&self.projected, width, point);
                vectorised!({
                    for ((row, query), gradient) in rows.iter_mut().zip(queries).zip(gradients) {
                        for (e, &g) in embedding.chunks_exact(width).zip(gradient) {
                            row.iter_mut().zip(e).for_each(|(d, e)| *d += g * e);
                        }
                        for (to, &g) in block.chunks_exact_mut(width).zip(gradient) {
                            to.iter_mut().zip(query).for_each(|(d, q)| *d += g * q);
                        }
                    }
                });
            },
        );
        [(to_projected, vec![batch, heads, n, width]), (to_embedding, vec![batch, n, m, width])]
    }
}
