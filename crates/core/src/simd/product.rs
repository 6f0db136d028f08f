//! Matrix products of a few dozen columns on one thread: the shared layers of the positional encoding, whose operands
//! fit into the nearest caches while a block of rows is worked on.

use pulp::{Arch, Simd, WithSimd};

/// Rows of the left matrix that are multiplied together.
const ROWS: usize = 6;

/// `out [R, N] += left [R, K] right [K, N]`, all row-major.
///
/// # Panics
/// When the lengths do not fit together.
pub fn add_product(out: &mut [f32], left: &[f32], right: &[f32], inner: usize) {
    let (rows, columns) = (left.len() / inner.max(1), right.len() / inner.max(1));
    assert_eq!((left.len(), right.len()), (rows * inner, inner * columns), "rows of {inner}");
    assert_eq!(out.len(), rows * columns, "{rows} rows of {columns}");
    if !out.is_empty() {
        let left = Left { values: left, row: inner, inner: 1 };
        Arch::new().dispatch(Product { out, left, right, rows, columns, bias: None, rectify: false });
    }
}

/// `out [R, N] = x [R, K] weight [K, N] + bias [N]`, all row-major; with `rectify` negative results become 0 and NaN stays.
///
/// # Panics
/// When the lengths do not fit together.
pub fn map_rows(out: &mut [f32], x: &[f32], weight: &[f32], bias: &[f32], rectify: bool) {
    let columns = bias.len();
    let inner = weight.len() / columns.max(1);
    let rows = x.len() / inner.max(1);
    assert_eq!((x.len(), weight.len()), (rows * inner, inner * columns), "rows of {inner}");
    assert_eq!(out.len(), rows * columns, "{rows} rows of {columns}");
    if !out.is_empty() {
        let left = Left { values: x, row: inner, inner: 1 };
        Arch::new().dispatch(Product { out, left, right: weight, rows, columns, bias: Some(bias), rectify });
    }
}

/// `out [M, N] += left [R, M]^T right [R, N]`, all row-major.
///
/// # Panics
/// When the lengths do not fit together.
pub fn add_transposed_product(out: &mut [f32], left: &[f32], right: &[f32], rows: usize) {
    let (width, columns) = (left.len() / rows.max(1), right.len() / rows.max(1));
    assert_eq!((left.len(), right.len()), (rows * width, rows * columns), "{rows} rows");
    assert_eq!(out.len(), width * columns, "{width} rows of {columns}");
    if !out.is_empty() {
        let left = Left { values: left, row: 1, inner: width };
        Arch::new().dispatch(Product { out, left, right, rows: width, columns, bias: None, rectify: false });
    }
}

/// The left matrix: entry `[r, k]` lies at `r * row + k * inner`.
#[derive(Clone, Copy)]
struct Left<'a> {
    values: &'a [f32],
    row: usize,
    inner: usize,
}

struct Product<'a> {
    out: &'a mut [f32],
    left: Left<'a>,
    right: &'a [f32],
    rows: usize,
    columns: usize,
    /// What every row starts from instead of what it holds.
    bias: Option<&'a [f32]>,
    rectify: bool,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { out, left, right, rows, columns, bias, rectify } = self;
        let whole = columns / S::F32_LANES;
        if whole * S::F32_LANES != columns {
            return plain(out, left, right, columns, bias, rectify);
        }
        let (right, _) = S::as_simd_f32s(right);
        let (out, _) = S::as_mut_simd_f32s(out);
        let bias = bias.map(|bias| S::as_simd_f32s(bias).0);
        // As many vectors at a time as the registers hold beside the operands.
        let widest = if S::F32_LANES >= 16 { 4 } else { 2 };
        let mut start = 0;
        while start < whole {
            let mut tile = Tile { left, right, row: 0, stride: whole, start, bias, rectify };
            // The columns stay in a near cache while all rows pass.
            start += match widest.min(whole - start) {
                4 => tile.add_rows::<S, 4>(simd, out, rows),
                2 | 3 => tile.add_rows::<S, 2>(simd, out, rows),
                _ => tile.add_rows::<S, 1>(simd, out, rows),
            };
        }
    }
}

/// Any number of columns.
#[inline(always)]
fn plain(
    out: &mut [f32],
    left: Left<'_>,
    right: &[f32],
    columns: usize,
    bias: Option<&[f32]>,
    rectify: bool,
) {
    for (row, out) in out.chunks_exact_mut(columns).enumerate() {
        if let Some(bias) = bias {
            out.copy_from_slice(bias);
        }
        for (k, right) in right.chunks_exact(columns).enumerate() {
            let a = left.values[row * left.row + k * left.inner];
            for (o, b) in out.iter_mut().zip(right) {
                *o += a * b;
            }
        }
        if rectify {
            out.iter_mut().for_each(|o| *o = if *o <= 0.0 { 0.0 } else { *o });
        }
    }
}

/// A few rows times a few vectors of columns, whose sums stay in registers.
struct Tile<'a, V> {
    left: Left<'a>,
    right: &'a [V],
    row: usize,
    /// Vectors per row of `right` and of the result.
    stride: usize,
    start: usize,
    bias: Option<&'a [V]>,
    rectify: bool,
}

impl<T: Copy> Tile<'_, T> {
    /// All rows, `V` vectors; returns `V`.
    #[inline(always)]
    fn add_rows<S: Simd<f32s = T>, const V: usize>(&mut self, simd: S, out: &mut [T], rows: usize) -> usize {
        while self.row < rows {
            self.row += match rows - self.row {
                1 => self.add::<S, V, 1>(simd, out),
                2 => self.add::<S, V, 2>(simd, out),
                3..ROWS => self.add::<S, V, 3>(simd, out),
                _ => self.add::<S, V, ROWS>(simd, out),
            };
        }
        V
    }

    /// `R` rows, `V` vectors; returns `R`.
    #[inline(always)]
    fn add<S: Simd<f32s = T>, const V: usize, const R: usize>(&self, simd: S, out: &mut [T]) -> usize {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        // Entry by entry: slices would be copied through the stack.
        for (r, sums) in sums.iter_mut().enumerate() {
            let from = match self.bias {
                Some(bias) => &bias[self.start..],
                None => &out[(self.row + r) * self.stride + self.start..],
            };
            for (v, sum) in sums.iter_mut().enumerate() {
                *sum = from[v];
            }
        }
        let mut at = self.row * self.left.row;
        for right in self.right.chunks_exact(self.stride) {
            let right = &right[self.start..self.start + V];
            for (r, sums) in sums.iter_mut().enumerate() {
                let a = simd.splat_f32s(self.left.values[at + r * self.left.row]);
                for (sum, &b) in sums.iter_mut().zip(right) {
                    *sum = simd.mul_add_e_f32s(a, b, *sum);
                }
            }
            at += self.left.inner;
        }
        let zero = simd.splat_f32s(0.0);
        for (r, sums) in sums.iter().enumerate() {
            let out = &mut out[(self.row + r) * self.stride + self.start..];
            for (v, &sum) in sums.iter().enumerate() {
                // A maximum would lose NaN on some processors.
                out[v] = match self.rectify {
                    true => simd.select_f32s(simd.less_than_f32s(sum, zero), zero, sum),
                    false => sum,
                };
            }
        }
        R
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, step: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * step) % 101) as f32 / 50.0 - 1.0).collect()
    }

    #[test]
    fn nan_is_not_rectified() {
        for columns in [7, 64] {
            let mut out = vec![0.0; 2 * columns];
            map_rows(&mut out, &[f32::NAN, -1.0], &vec![1.0; columns], &vec![0.5; columns], true);
            assert!(out[..columns].iter().all(|y| y.is_nan()) && out[columns..].iter().all(|&y| y == 0.0));
        }
    }

    #[test]
    fn agrees_with_sums_in_double_precision() {
        for (rows, inner, columns) in
            [(13, 6, 16), (20, 16, 32), (7, 32, 64), (25, 64, 128), (5, 3, 7), (1, 1, 48), (9, 5, 112)]
        {
            let (left, right) = (numbers(rows * inner, 37), numbers(inner * columns, 53));
            let mut transposed = vec![0.0; rows * inner];
            for r in 0..rows {
                (0..inner).for_each(|k| transposed[k * rows + r] = left[r * inner + k]);
            }
            let mut mapped = vec![f32::NAN; rows * columns];
            map_rows(&mut mapped, &left, &right, &vec![-0.25; columns], true);
            let (mut plain, mut turned) = (vec![0.5; rows * columns], vec![0.5; rows * columns]);
            add_product(&mut plain, &left, &right, inner);
            add_transposed_product(&mut turned, &transposed, &right, inner);
            for r in 0..rows {
                for c in 0..columns {
                    let sum = |k: usize| left[r * inner + k] as f64 * right[k * columns + c] as f64;
                    let expected = 0.5 + (0..inner).map(sum).sum::<f64>();
                    let results = [plain[r * columns + c], turned[r * columns + c], mapped[r * columns + c]];
                    for (got, expected) in
                        results.into_iter().zip([expected, expected, (expected - 0.75).max(0.0)])
                    {
                        assert!(
                            (got as f64 - expected).abs() < 2e-5,
                            "{rows} {inner} {columns}: {got} {expected}"
                        );
                    }
                }
            }
        }
    }
}
