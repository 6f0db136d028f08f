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
    pub(super) fn queries(&self) -> usize {
        self.rows - 1
    }

    /// Number of reference points.
    pub(super) fn references(&self) -> usize {
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
    pub(super) fn row(&self, i: usize) -> &[f32] {
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
    let shift = Shift::of(similarity, columns);

    // Exponentials relative to the row's shift stay in `weights`; sums per row, partial sums per column.
    let mut weights = vec![0.0f32; similarity.len()];
    let (row_sums, column_sums): (Vec<Vec<f32>>, Vec<Vec<f32>>) = weights
        .par_chunks_mut(BLOCK * columns)
        .zip(similarity.par_chunks(BLOCK * columns))
        .enumerate()
        .map(|(b, (out, block))| {
            let mut column_sum = vec![0.0f32; columns];
            let rows = out.chunks_exact_mut(columns).zip(block.chunks_exact(columns)).enumerate();
            let sums =
                rows.map(|(r, (out, row))| shift.exponentials(b * BLOCK + r, row, out, &mut column_sum));
            let sums = sums.collect::<Vec<f32>>();
            (sums, column_sum)
        })
        .unzip();
    let scales = |sums: &[f32], overlap: &[f32]| -> Vec<f32> {
        sums.iter().zip(std::iter::once(&1.0).chain(overlap)).map(|(&sum, &overlap)| overlap / sum).collect()
    };
    let column_scale = scales(&merge(column_sums, |a, b| a + b), overlap_reference);
    let row_scale = scales(&row_sums.concat(), overlap_query);

    let best: Vec<BlockLabels> = weights
        .par_chunks_mut(BLOCK * columns)
        .zip(similarity.par_chunks(BLOCK * columns))
        .zip(row_scale.par_chunks(BLOCK))
        .enumerate()
        .map(|(b, ((out, block), scale))| {
            let mut column_best = (vec![f32::NEG_INFINITY; columns], vec![0u32; columns]);
            let rows = out.chunks_exact_mut(columns).zip(block.chunks_exact(columns)).zip(scale);
            let labels = rows
                .enumerate()
                .map(|(r, ((out, row), &scale))| {
                    shift.weigh(row, out, scale, &column_scale);
                    let index = (b * BLOCK + r) as u32;
                    vectorised!({
                        let columns = column_best.0.iter_mut().zip(&mut column_best.1).zip(&*out);
                        for ((best, row), &o) in columns {
                            let better = o > *best;
                            *best = if better { o } else { *best };
                            *row = if better { index } else { *row };
                        }
                    });
                    best_column(out)
                })
                .collect();
            (labels, column_best.0.into_iter().zip(column_best.1).collect())
        })
        .collect();
    let label_query = best.iter().flat_map(|(labels, _)| labels).copied().skip(1).collect();
    let column_best = merge(best.into_iter().map(|(_, c)| c).collect(), |a, b| if b.0 > a.0 { b } else { a });
    let label_reference = column_best.into_iter().map(|(_, row)| row).skip(1).collect();
    Assignment { rows, columns, weights, label_query, label_reference }
}

/// What similarities are taken relative to before their exponentials, which keeps these in range.
enum Shift {
    /// The largest of all similarities: one exponential serves the row and the column, and is squared.
    Shared(f32),
    /// The maxima of rows and columns, for similarities further apart than [`SPREAD`].
    Separate { rows: Vec<f32>, columns: Vec<f32> },
}

/// Squares of exponentials of this are normal numbers still.
const SPREAD: f32 = 40.0;

impl Shift {
    fn of(similarity: &[f32], columns: usize) -> Self {
        let ranges: Vec<[f32; 2]> = similarity
            .par_chunks(BLOCK * columns)
            .map(|block| vectorised!([lanes(block, f32::INFINITY, smaller), maximum(block)]))
            .collect();
        let smallest = ranges.iter().map(|range| range[0]).fold(f32::INFINITY, smaller);
        let largest = ranges.iter().map(|range| range[1]).fold(f32::NEG_INFINITY, larger);
        if largest - smallest <= SPREAD {
            return Self::Shared(largest);
        }
        let by_block = |block: &[f32]| vectorised!(by_column(block, columns, f32::NEG_INFINITY, larger));
        let rows = similarity.par_chunks(columns).with_min_len(BLOCK);
        Self::Separate {
            rows: rows.map(|row| vectorised!(maximum(row))).collect(),
            columns: merge(similarity.par_chunks(BLOCK * columns).map(by_block).collect(), larger),
        }
    }

    /// Exponentials of row `r` relative to its shift, and their sum; those relative to the columns' are added up.
    fn exponentials(&self, r: usize, row: &[f32], out: &mut [f32], column_sum: &mut [f32]) -> f32 {
        vectorised!({
            match self {
                Self::Shared(shift) => {
                    for ((o, &s), c) in out.iter_mut().zip(row).zip(column_sum) {
                        *o = exp(s - shift);
                        *c += *o;
                    }
                }
                Self::Separate { rows, columns } => {
                    let max = rows[r];
                    for (o, ((&s, c), &m)) in out.iter_mut().zip(row.iter().zip(column_sum).zip(columns)) {
                        *o = exp(s - max);
                        *c += exp(s - m);
                    }
                }
            }
            sum(out)
        })
    }

    /// From the exponentials of a row to its weights.
    fn weigh(&self, row: &[f32], out: &mut [f32], scale: f32, column_scale: &[f32]) {
        vectorised!(match self {
            Self::Shared(_) => {
                out.iter_mut().zip(column_scale).for_each(|(o, &c)| *o = *o * scale * (*o * c));
            }
            Self::Separate { columns, .. } => {
                for (o, ((&s, &m), &c)) in out.iter_mut().zip(row.iter().zip(columns).zip(column_scale)) {
                    *o *= scale * (exp(s - m) * c);
                }
            }
        });
    }
}

/// The first column of the largest weight.
fn best_column(weights: &[f32]) -> u32 {
    vectorised!({
        let max = maximum(weights);
        // Whole runs, which vectorises.
        let run = weights.chunks(64).position(|run| run.iter().fold(false, |found, &w| found | (w == max)));
        let first = run.unwrap_or(0) * 64;
        (first + weights[first..].iter().position(|&w| w == max).unwrap_or(0)) as u32
    })
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
fn smaller(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
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
        // Similarities 17 apart, and 56, where squares of exponentials would leave the range of f32.
        agrees_with_the_plain_formula(150, 90, 60.0, 5e-6, 0.0);
        agrees_with_the_plain_formula(150, 90, 18.0, 2e-5, 1e-35);
    }

    fn agrees_with_the_plain_formula(n: usize, m: usize, divisor: f32, tolerance: f64, underflow: f64) {
        let similarity: Vec<f32> =
            (0..(n + 1) * (m + 1)).map(|i| ((i * 7919) % 1009) as f32 / divisor - 8.0).collect();
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
                assert!(
                    (w - expected).abs() <= tolerance * expected + underflow,
                    "[{i}, {j}] {w} {expected}"
                );
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
