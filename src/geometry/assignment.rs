//! Soft assignment between two clouds from their similarity: softmax over rows times softmax over columns times the
//! overlap scores, background at index 0 (the release's form; `correlation` has the paper's).

use rayon::prelude::*;

use crate::simd::{exp_of_negative as exp, vectorised};

/// Rows per parallel task; fixed, so that sums do not depend on the number of threads.
const BLOCK: usize = 64;

/// Best column of every row of a block, and the best (weight, row) of every column.
type BlockLabels = (Vec<u32>, Vec<(f32, u32)>);

/// Soft assignment of `rows - 1` query to `columns - 1` reference points.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// N + 1.
    pub rows: usize,
    /// M + 1.
    pub columns: usize,
    /// `[N + 1, M + 1]`, background first.
    pub weights: Vec<f32>,
    /// Best column of every query point over `weights`, `[N]`; 0 is the background, j is reference point j - 1.
    pub label_query: Vec<u32>,
    /// Best row of every reference point, `[M]`; 0 is the background.
    pub label_reference: Vec<u32>,
}

impl Assignment {
    /// Number of query points.
    pub fn queries(&self) -> usize {
        self.rows - 1
    }

    /// Number of reference points.
    pub fn references(&self) -> usize {
        self.columns - 1
    }

    /// 1 for query points matched to a reference point, 0 for background, `[N]`.
    pub fn foreground_query(&self) -> Vec<f32> {
        self.label_query.iter().map(|&l| f32::from(l > 0)).collect()
    }

    /// 1 for reference points matched to a query point, 0 for background, `[M]`.
    pub fn foreground_reference(&self) -> Vec<f32> {
        self.label_reference.iter().map(|&l| f32::from(l > 0)).collect()
    }

    /// Weights of query point `i` to all reference points, `[M]`.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.weights[(i + 1) * self.columns + 1..(i + 2) * self.columns]
    }
}

/// Assignment of a similarity matrix `[N + 1, M + 1]` with the overlap scores `[N]` and `[M]` (0..1, the
/// background's is 1). Sizes follow from the overlap scores.
///
/// # Panics
/// When `similarity` is not `(overlap_query.len() + 1) * (overlap_reference.len() + 1)` long.
pub fn match_assignment(similarity: &[f32], overlap_query: &[f32], overlap_reference: &[f32]) -> Assignment {
    let (rows, columns) = (overlap_query.len() + 1, overlap_reference.len() + 1);
    assert_eq!(similarity.len(), rows * columns, "similarity entries for {rows} rows x {columns} columns");
    let blocks = || similarity.par_chunks(BLOCK * columns);

    let row_max: Vec<f32> =
        similarity.par_chunks(columns).with_min_len(BLOCK).map(|row| vectorised(|| maximum(row))).collect();
    let column_max = merge(
        blocks().map(|block| vectorised(|| by_column(block, columns, f32::NEG_INFINITY, larger))).collect(),
        larger,
    );

    // exp relative to the row's maximum stays in `weights`; sums per row, partial sums per column.
    let mut weights = vec![0.0f32; similarity.len()];
    let (row_sums, column_sums): (Vec<Vec<f32>>, Vec<Vec<f32>>) = weights
        .par_chunks_mut(BLOCK * columns)
        .zip(blocks())
        .zip(row_max.par_chunks(BLOCK))
        .map(|((out, block), max)| {
            let mut column_sum = vec![0.0f32; columns];
            let rows = out.chunks_exact_mut(columns).zip(block.chunks_exact(columns)).zip(max);
            let sums = rows
                .map(|((out, row), &max)| {
                    vectorised(|| {
                        let columns = row.iter().zip(&mut column_sum).zip(&column_max);
                        for (o, ((&s, c), &m)) in out.iter_mut().zip(columns) {
                            *o = exp(s - max);
                            *c += exp(s - m);
                        }
                        sum(out)
                    })
                })
                .collect::<Vec<f32>>();
            (sums, column_sum)
        })
        .unzip();
    let column_sum = merge(column_sums, |a, b| a + b);
    let column_scale: Vec<f32> = column_sum
        .iter()
        .zip(std::iter::once(&1.0).chain(overlap_reference))
        .map(|(&sum, &overlap)| overlap / sum)
        .collect();
    let row_scale: Vec<f32> = row_sums
        .concat()
        .iter()
        .zip(std::iter::once(&1.0).chain(overlap_query))
        .map(|(&sum, &overlap)| overlap / sum)
        .collect();

    let best: Vec<BlockLabels> = weights
        .par_chunks_mut(BLOCK * columns)
        .zip(blocks())
        .zip(row_scale.par_chunks(BLOCK))
        .enumerate()
        .map(|(b, ((out, block), scale))| {
            let mut column_best = vec![(f32::NEG_INFINITY, 0u32); columns];
            let rows = out.chunks_exact_mut(columns).zip(block.chunks_exact(columns)).zip(scale);
            let labels = rows
                .enumerate()
                .map(|(r, ((out, row), &scale))| {
                    let index = (b * BLOCK + r) as u32;
                    let max = vectorised(|| {
                        let per_column = row.iter().zip(&column_max).zip(&column_scale);
                        for (o, ((&s, &m), &c)) in out.iter_mut().zip(per_column) {
                            *o *= scale * (exp(s - m) * c);
                        }
                        for (best, &o) in column_best.iter_mut().zip(out.iter()) {
                            *best = if o > best.0 { (o, index) } else { *best };
                        }
                        maximum(out)
                    });
                    out.iter().position(|&o| o == max).unwrap_or(0) as u32
                })
                .collect();
            (labels, column_best)
        })
        .collect();
    let label_query = best.iter().flat_map(|(labels, _)| labels).copied().skip(1).collect();
    let column_best = merge(best.into_iter().map(|(_, c)| c).collect(), |a, b| if b.0 > a.0 { b } else { a });
    let label_reference = column_best.into_iter().map(|(_, row)| row).skip(1).collect();
    Assignment { rows, columns, weights, label_query, label_reference }
}

/// Folds each column of a row-major block.
#[inline(always)]
fn by_column(block: &[f32], columns: usize, start: f32, fold: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    let mut result = vec![start; columns];
    for row in block.chunks_exact(columns) {
        result.iter_mut().zip(row).for_each(|(r, &s)| *r = fold(*r, s));
    }
    result
}

/// Folds the blocks' column results in block order.
fn merge<T: Copy>(blocks: Vec<Vec<T>>, fold: impl Fn(T, T) -> T) -> Vec<T> {
    blocks
        .into_iter()
        .reduce(|mut a, b| {
            a.iter_mut().zip(b).for_each(|(x, y)| *x = fold(*x, y));
            a
        })
        .unwrap_or_default()
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

#[inline(always)]
fn maximum(values: &[f32]) -> f32 {
    lanes(values, f32::NEG_INFINITY, larger)
}

#[inline(always)]
fn sum(values: &[f32]) -> f32 {
    lanes(values, 0.0, |a, b| a + b)
}

/// Reduction in 16 independent lanes, which the compiler can vectorise.
#[inline(always)]
fn lanes(values: &[f32], start: f32, fold: impl Fn(f32, f32) -> f32) -> f32 {
    let (runs, rest) = values.as_chunks::<16>();
    let mut lane = [start; 16];
    for run in runs {
        lane.iter_mut().zip(run).for_each(|(l, &v)| *l = fold(*l, v));
    }
    lane.into_iter().chain(rest.iter().copied()).fold(start, fold)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_plain_formula_beyond_one_block() {
        let (n, m) = (150, 90);
        let similarity: Vec<f32> =
            (0..(n + 1) * (m + 1)).map(|i| ((i * 7919) % 1009) as f32 / 60.0 - 8.0).collect();
        let overlap =
            |k: usize| (0..k).map(|i| 0.2 + 0.7 * ((i * 31) % 17) as f32 / 17.0).collect::<Vec<f32>>();
        let (oq, or) = (overlap(n), overlap(m));
        let got = match_assignment(&similarity, &oq, &or);
        let s = |i: usize, j: usize| (similarity[i * (m + 1) + j] as f64).exp();
        for i in 0..=n {
            for j in 0..=m {
                let row: f64 = (0..=m).map(|k| s(i, k)).sum();
                let column: f64 = (0..=n).map(|k| s(k, j)).sum();
                let o = |list: &[f32], k: usize| if k == 0 { 1.0 } else { list[k - 1] as f64 };
                let expected = s(i, j) / row * (s(i, j) / column) * o(&oq, i) * o(&or, j);
                let w = got.weights[i * (m + 1) + j] as f64;
                assert!((w - expected).abs() <= 5e-6 * expected, "[{i}, {j}] {w} {expected}");
            }
        }
        for (i, &label) in got.label_query.iter().enumerate() {
            let row = &got.weights[(i + 1) * (m + 1)..(i + 2) * (m + 1)];
            assert!(row.iter().all(|&w| w <= row[label as usize]));
        }
        for (j, &label) in got.label_reference.iter().enumerate() {
            let column = |i: usize| got.weights[i * (m + 1) + j + 1];
            assert!((0..=n).all(|i| column(i) <= column(label as usize)));
        }
    }
}
