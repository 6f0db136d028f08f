//! Scores of the relative positions: the structure embedding is read once for all heads.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::tape::{Values, plain};
use crate::simd::{dot, vectorised};

pub fn relative_scores(projected: &Tensor<4>, embedding: &Tensor<4>) -> Option<Tensor<4>> {
    let [batch, heads, n, width] = projected.dims();
    let m = embedding.dims()[2];
    let (projected, embedding) = (Values::of(projected)?, Values::of(embedding)?);
    let mut scores = vec![0.0f32; batch * heads * n * m];
    // Rows [b, h, n] of the scores by (b, n), which share the embedding's rows.
    let mut rows: Vec<Vec<&mut [f32]>> = (0..batch * n).map(|_| Vec::with_capacity(heads)).collect();
    for (row, scores) in scores.chunks_exact_mut(m.max(1)).enumerate() {
        rows[row / (heads * n) * n + row % n].push(scores);
    }
    rows.par_iter_mut().zip(embedding.par_chunks_exact(m * width)).enumerate().for_each(
        |(at, (rows, embedding))| {
            let (b, i) = (at / n, at % n);
            vectorised(|| {
                for (h, row) in rows.iter_mut().enumerate() {
                    let query = &projected[((b * heads + h) * n + i) * width..][..width];
                    for (score, e) in row.iter_mut().zip(embedding.chunks_exact(width)) {
                        *score = dot(query, e);
                    }
                }
            });
        },
    );
    Some(plain(scores, [batch, heads, n, m]))
}
