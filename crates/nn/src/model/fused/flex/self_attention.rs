//! Attention of a vision transformer's tokens, straight from the rows of the joint projection.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::{add_product, dot, exp_of_negative, vectorised};

use super::{
    super::PositionBias,
    rows::{merged_heads, transposed},
    tape::{Values, plain},
};

/// Rows of scores that are worked on at a time, so that they stay in the nearest cache.
const ROWS: usize = 48;
/// Keys that are multiplied together at most: rows of longer blocks would fall into the same lines of the cache.
const KEYS: usize = 512;
/// Scores are padded to whole vectors.
const LANES: usize = 16;

pub fn self_attention(qkv: &Tensor<3>, heads: usize, bias: Option<PositionBias>) -> Option<Tensor<3>> {
    let [batch, tokens, joint] = qkv.dims();
    let width = joint / 3;
    let values = Values::of(qkv)?;
    let bias = match bias {
        None => Bias::None,
        Some(bias) => Bias::of(bias)?,
    };
    let read: Vec<Vec<f32>> = (0..batch * heads)
        .into_par_iter()
        .map(|item| {
            let image = &values[item / heads * tokens * joint..][..tokens * joint];
            let d = width / heads;
            let parts = [0, 1, 2].map(|part| &image[part * width + item % heads * d..]);
            let rows = Rows { parts, stride: joint, d, counts: [tokens; 2] };
            head(&rows, item % heads, &bias)
        })
        .collect();
    Some(plain(merged_heads(&read, heads, tokens, width / heads), [batch, tokens, width]))
}

/// Query, key and value of an image's tokens in a head: row `t` of each lies at `t * stride`.
pub(super) struct Rows<'a> {
    pub parts: [&'a [f32]; 3],
    pub stride: usize,
    /// Channels of a head.
    pub d: usize,
    /// Queries, then keys and values.
    pub counts: [usize; 2],
}

impl Rows<'_> {
    /// Query, key or value (0, 1, 2) of each token, `[d]` each.
    fn part(&self, index: usize) -> impl Iterator<Item = &[f32]> {
        self.parts[index].chunks(self.stride).take(self.counts[index.min(1)]).map(|row| &row[..self.d])
    }
}

/// [`PositionBias`] in memory.
pub(super) enum Bias {
    None,
    Table { values: Values, tokens: usize },
    Axes { rows: Values, columns: Values, height: usize, width: usize },
}

impl Bias {
    fn of(bias: PositionBias) -> Option<Self> {
        Some(match bias {
            PositionBias::Table(table) => Self::Table { values: Values::of(table)?, tokens: table.dims()[2] },
            PositionBias::Axes { rows, columns } => Self::Axes {
                height: rows.dims()[0],
                width: columns.dims()[0],
                rows: Values::of(rows)?,
                columns: Values::of(columns)?,
            },
        })
    }

    /// Products of each query with the embeddings of the keys' rows, then of their columns: `[T, h + w]`.
    fn products(&self, rows: &Rows) -> Vec<f32> {
        let Self::Axes { rows: by_row, columns: by_column, height, width } = self else { return Vec::new() };
        let (h, w, d) = (*height, *width, rows.d);
        let mut products = vec![0.0f32; rows.counts[0] * (h + w)];
        vectorised!({
            for (t, (out, query)) in products.chunks_exact_mut(h + w).zip(rows.part(0)).enumerate() {
                let of_row = by_row[t / w * h * d..][..h * d].chunks_exact(d);
                let of_column = by_column[t % w * w * d..][..w * d].chunks_exact(d);
                out.iter_mut().zip(of_row.chain(of_column)).for_each(|(o, e)| *o = dot(query, e));
            }
        });
        products
    }

    /// What the scores of query `t` with the keys from `first` on start from.
    #[inline(always)]
    fn start(&self, scores: &mut [f32], products: &[f32], head: usize, t: usize, first: usize) {
        match self {
            Self::None => {}
            Self::Table { values, tokens } => {
                let row = &values[(head * tokens + t) * tokens..][..*tokens];
                scores.copy_from_slice(&row[first..first + scores.len()]);
            }
            Self::Axes { height, width, .. } => {
                let (rows, columns) = products[t * (height + width)..][..height + width].split_at(*height);
                let (mut key, mut rest) = (first, scores);
                while !rest.is_empty() {
                    let (row, column) = (rows[key / width], &columns[key % width..]);
                    let run = column.len().min(rest.len());
                    let (now, later) = rest.split_at_mut(run);
                    now.iter_mut().zip(column).for_each(|(s, c)| *s = row + c);
                    (key, rest) = (key + run, later);
                }
            }
        }
    }
}

/// What the queries of a head read, `[T, d]`.
pub(super) fn head(rows: &Rows, head: usize, bias: &Bias) -> Vec<f32> {
    let ([count, tokens], d) = (rows.counts, rows.d);
    let blocks = tokens.div_ceil(KEYS);
    let columns = tokens.div_ceil(blocks.max(1)).next_multiple_of(LANES);
    let present = |block: usize| columns.min(tokens.saturating_sub(block * columns));
    let scale = 1.0 / (d as f32).sqrt();
    // Keys `[block, d, columns]`; padded ones get values of zero.
    let mut queries = vec![0.0f32; count * d];
    for (scaled, query) in queries.chunks_exact_mut(d).zip(rows.part(0)) {
        scaled.iter_mut().zip(query).for_each(|(q, x)| *q = x * scale);
    }
    let padded = |part: usize| {
        let mut padded = vec![0.0f32; blocks * columns * d];
        padded.chunks_exact_mut(d).zip(rows.part(part)).for_each(|(padded, row)| padded.copy_from_slice(row));
        padded
    };
    let mut keys = Vec::with_capacity(blocks * columns * d);
    for block in padded(1).chunks_exact((columns * d).max(1)) {
        keys.extend_from_slice(&transposed(block, d));
    }
    let values = padded(2);
    let products = bias.products(rows);
    let mut read = vec![0.0f32; count * d];
    let mut scores = vec![0.0f32; blocks * ROWS * columns];
    for (chunk, (read, queries)) in read.chunks_mut(ROWS * d).zip(queries.chunks(ROWS * d)).enumerate() {
        let count = queries.len() / d;
        let of_block = |block: usize| block * ROWS * columns..(block * ROWS + count) * columns;
        for (block, keys) in keys.chunks_exact(d * columns).enumerate() {
            let scores = &mut scores[of_block(block)];
            scores.fill(0.0);
            vectorised!({
                for (r, row) in scores.chunks_exact_mut(columns).enumerate() {
                    let row = &mut row[..present(block)];
                    bias.start(row, &products, head, chunk * ROWS + r, block * columns);
                }
            });
            add_product(scores, queries, keys, d);
        }
        let mut sums = [0.0f32; ROWS];
        vectorised!({
            for (r, sum) in sums[..count].iter_mut().enumerate() {
                let row = |block: usize| (block * ROWS + r) * columns..;
                let mut top = f32::NEG_INFINITY;
                for block in 0..blocks {
                    top = top.max(largest(&scores[row(block)][..present(block)]));
                }
                for block in 0..blocks {
                    *sum += exponentials(&mut scores[row(block)][..present(block)], top);
                }
            }
        });
        for (block, values) in values.chunks_exact(columns * d).enumerate() {
            add_product(read, &scores[of_block(block)], values, columns);
        }
        for (row, sum) in read.chunks_exact_mut(d).zip(sums) {
            let scale = 1.0 / sum;
            row.iter_mut().for_each(|r| *r *= scale);
        }
    }
    read
}

#[inline(always)]
pub(super) fn largest(row: &[f32]) -> f32 {
    let mut largest = [f32::NEG_INFINITY; LANES];
    let (runs, rest) = row.as_chunks::<LANES>();
    for run in runs {
        largest.iter_mut().zip(run).for_each(|(l, &x)| *l = if x > *l { x } else { *l });
    }
    largest.into_iter().chain(rest.iter().copied()).fold(f32::NEG_INFINITY, f32::max)
}

/// Replaces scores by their exponentials relative to the largest; returns their sum.
#[inline(always)]
pub(super) fn exponentials(row: &mut [f32], largest: f32) -> f32 {
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
