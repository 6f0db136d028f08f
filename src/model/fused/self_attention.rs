//! Attention of a vision transformer's tokens, straight from the rows of the joint projection.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::tape::{Values, plain};
use crate::simd::{add_product, exp_of_negative, vectorised};

/// Rows of scores that are worked on at a time, so that they stay in the nearest cache.
const ROWS: usize = 48;
/// Scores are padded to whole vectors.
const LANES: usize = 16;

pub fn self_attention(qkv: &Tensor<3>, heads: usize) -> Option<Tensor<3>> {
    let [batch, tokens, joint] = qkv.dims();
    let width = joint / 3;
    let values = Values::of(qkv)?;
    let mut out = vec![0.0f32; batch * tokens * width];
    let read: Vec<Vec<f32>> = (0..batch * heads)
        .into_par_iter()
        .map(|item| {
            let rows = &values[item / heads * tokens * joint..][..tokens * joint];
            head(rows, joint, item % heads * (width / heads), width / heads)
        })
        .collect();
    out.par_chunks_exact_mut((tokens * width).max(1)).zip(read.par_chunks(heads)).for_each(|(out, read)| {
        for (t, row) in out.chunks_exact_mut(width).enumerate() {
            for (part, read) in row.chunks_exact_mut(width / heads).zip(read) {
                part.copy_from_slice(&read[t * part.len()..][..part.len()]);
            }
        }
    });
    Some(plain(out, [batch, tokens, width]))
}

/// What the head whose channels begin at `start` reads, `[T, d]`.
fn head(rows: &[f32], joint: usize, start: usize, d: usize) -> Vec<f32> {
    let (tokens, width) = (rows.len() / joint, joint / 3);
    let padded = tokens.next_multiple_of(LANES);
    let scale = 1.0 / (d as f32).sqrt();
    let (mut queries, mut keys) = (vec![0.0f32; tokens * d], vec![0.0f32; d * padded]);
    // Padded keys get values of zero.
    let mut values = vec![0.0f32; padded * d];
    for (t, row) in rows.chunks_exact(joint).enumerate() {
        let part = |index: usize| &row[index * width + start..][..d];
        queries[t * d..][..d].iter_mut().zip(part(0)).for_each(|(q, x)| *q = x * scale);
        part(1).iter().enumerate().for_each(|(c, &x)| keys[c * padded + t] = x);
        values[t * d..][..d].copy_from_slice(part(2));
    }
    let mut read = vec![0.0f32; tokens * d];
    let mut scores = vec![0.0f32; ROWS * padded];
    for (read, queries) in read.chunks_mut(ROWS * d).zip(queries.chunks(ROWS * d)) {
        let scores = &mut scores[..queries.len() / d * padded];
        scores.fill(0.0);
        add_product(scores, queries, &keys, d);
        let mut sums = [0.0f32; ROWS];
        vectorised(|| {
            for (row, sum) in scores.chunks_exact_mut(padded).zip(&mut sums) {
                *sum = exponentials(&mut row[..tokens]);
            }
        });
        add_product(read, scores, &values, padded);
        for (row, sum) in read.chunks_exact_mut(d).zip(sums) {
            let scale = 1.0 / sum;
            row.iter_mut().for_each(|r| *r *= scale);
        }
    }
    read
}

/// Replaces scores by their exponentials relative to the largest; returns their sum.
#[inline(always)]
fn exponentials(row: &mut [f32]) -> f32 {
    let mut largest = [f32::NEG_INFINITY; LANES];
    let (runs, rest) = row.as_chunks::<LANES>();
    for run in runs {
        largest.iter_mut().zip(run).for_each(|(l, &x)| *l = if x > *l { x } else { *l });
    }
    let largest = largest.into_iter().chain(rest.iter().copied()).fold(f32::NEG_INFINITY, f32::max);
    let mut sums = [0.0f32; LANES];
    let (runs, rest) = row.as_chunks_mut::<LANES>();
    for run in runs {
        for (x, sum) in run.iter_mut().zip(&mut sums) {
            *x = exp_of_negative(*x - largest);
            *sum += *x;
        }
    }
    let mut sum: f32 = sums.iter().sum();
    for x in rest {
        *x = exp_of_negative(*x - largest);
        sum += *x;
    }
    sum
}
