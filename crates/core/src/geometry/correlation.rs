//! Soft assignment in the paper's form, "overlap-aware correlation matrix": X = softmax((O_Q * F_Q) (O_P * F_P)^T), with
//! the overlap already in the similarities and no other factor.
//!
//! The equation leaves the axis open. It is the last one here: every query point gets a distribution over the reference
//! points and the background, which is what the first half of the paper's InfoNCE trains and what keeps the row sums,
//! the weights of the fine registration, of order 1.

use rayon::prelude::*;

use super::Assignment;

/// Assignment of a similarity matrix `[N + 1, M + 1]` (background first) by one softmax over its rows.
///
/// # Panics
/// When `similarity` is not `(queries + 1) * (references + 1)` long.
pub fn correlation_assignment(similarity: &[f32], queries: usize, references: usize) -> Assignment {
    let (rows, columns) = (queries + 1, references + 1);
    assert_eq!(similarity.len(), rows * columns, "similarity entries for {rows} rows x {columns} columns");
    let mut weights = similarity.to_vec();
    let label_query: Vec<u32> = weights
        .par_chunks_mut(columns)
        .with_min_len(64)
        .map(|row| {
            let best = (0..columns).fold(0, |a, b| if row[b] > row[a] { b } else { a });
            let max = row[best];
            row.iter_mut().for_each(|s| *s = (*s - max).exp());
            let scale = 1.0 / row.iter().sum::<f32>();
            row.iter_mut().for_each(|w| *w *= scale);
            best as u32
        })
        .skip(1)
        .collect();
    let mut best = vec![(f32::NEG_INFINITY, 0u32); columns];
    for (i, row) in weights.chunks_exact(columns).enumerate() {
        for (best, &w) in best.iter_mut().zip(row) {
            *best = if w > best.0 { (w, i as u32) } else { *best };
        }
    }
    let label_reference = best.into_iter().skip(1).map(|(_, row)| row).collect();
    Assignment { rows, columns, weights, label_query, label_reference }
}
