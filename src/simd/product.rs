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
        Arch::new().dispatch(Product { out, left, right, rows, columns });
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
        Arch::new().dispatch(Product { out, left, right, rows: width, columns });
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
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { out, left, right, rows, columns } = self;
        let whole = columns / S::F32_LANES;
        if whole * S::F32_LANES != columns {
            return plain(out, left, right, columns);
        }
        let (right, _) = S::as_simd_f32s(right);
        let (out, _) = S::as_mut_simd_f32s(out);
        // As many vectors at a time as the registers hold beside the operands.
        let widest = if S::F32_LANES >= 16 { 4 } else { 2 };
        let mut row = 0;
        while row < rows {
            let count = if row + ROWS <= rows { ROWS } else { 1 };
            let mut start = 0;
            while start < whole {
                let remaining = widest.min(whole - start);
                let tile = Tile { left, right, row, stride: whole, start };
                start += match (count, remaining) {
                    (ROWS, 4) => tile.add::<S, 4, ROWS>(simd, out),
                    (ROWS, 2 | 3) => tile.add::<S, 2, ROWS>(simd, out),
                    (ROWS, _) => tile.add::<S, 1, ROWS>(simd, out),
                    (_, 4) => tile.add::<S, 4, 1>(simd, out),
                    (_, 2 | 3) => tile.add::<S, 2, 1>(simd, out),
                    _ => tile.add::<S, 1, 1>(simd, out),
                };
            }
            row += count;
        }
    }
}

/// Any number of columns.
#[inline(always)]
fn plain(out: &mut [f32], left: Left<'_>, right: &[f32], columns: usize) {
    for (row, out) in out.chunks_exact_mut(columns).enumerate() {
        for (k, right) in right.chunks_exact(columns).enumerate() {
            let a = left.values[row * left.row + k * left.inner];
            for (o, b) in out.iter_mut().zip(right) {
                *o += a * b;
            }
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
}

impl<T: Copy> Tile<'_, T> {
    /// `R` rows, `V` vectors; returns `V`.
    #[inline(always)]
    fn add<S: Simd<f32s = T>, const V: usize, const R: usize>(&self, simd: S, out: &mut [T]) -> usize {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        for (r, sums) in sums.iter_mut().enumerate() {
            let at = (self.row + r) * self.stride + self.start;
            sums.copy_from_slice(&out[at..at + V]);
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
        for (r, sums) in sums.iter().enumerate() {
            let at = (self.row + r) * self.stride + self.start;
            out[at..at + V].copy_from_slice(sums);
        }
        V
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, step: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * step) % 101) as f32 / 50.0 - 1.0).collect()
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
            let (mut plain, mut turned) = (vec![0.5; rows * columns], vec![0.5; rows * columns]);
            add_product(&mut plain, &left, &right, inner);
            add_transposed_product(&mut turned, &transposed, &right, inner);
            for r in 0..rows {
                for c in 0..columns {
                    let sum = |k: usize| left[r * inner + k] as f64 * right[k * columns + c] as f64;
                    let expected = 0.5 + (0..inner).map(sum).sum::<f64>();
                    for got in [plain[r * columns + c], turned[r * columns + c]] {
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
