//! Matrix products of many columns: tasks compute panels of [`PANEL`] columns on their own, so that every part of the
//! right matrix is read once, by one core, and stays in its nearest cache while all rows of the left one pass.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::vectorised;

/// Columns of a panel, as wide as the heads of the usual vision transformers.
pub const PANEL: usize = 64;
/// Rows of the left matrix that are multiplied together.
const ROWS: usize = 6;

/// `out [R, PANEL] += left [R, K] right [K, N]` for the columns of `right` from `first` on; `left` is given by panels
/// `[R, PANEL]`.
///
/// # Panics
/// When the lengths do not fit together.
pub fn add_panel(out: &mut [f32], left: &[Vec<f32>], right: &[f32], first: usize) {
    let columns = right.len() / (left.len() * PANEL).max(1);
    assert!(left.iter().all(|panel| panel.len() == out.len()), "{} values in each panel", out.len());
    assert!(
        right.len() == left.len() * PANEL * columns && first + PANEL <= columns,
        "{first} of {columns} columns"
    );
    let mut packed = Block([[0.0f32; PANEL]; PANEL]);
    for (left, right) in left.iter().zip(right.chunks_exact(PANEL * columns)) {
        // As vectors: the weights come from memory, and calls of memcpy in between keep few of the loads in flight.
        vectorised!({
            for (packed, row) in packed.0.iter_mut().zip(right.chunks_exact(columns)) {
                if let Some(row) = row[first..].first_chunk() {
                    *packed = *row;
                }
            }
        });
        Arch::new().dispatch(Product { out, left, right: packed.0.as_flattened() });
    }
}

/// Part of the right matrix, whose vectors are lines of the cache.
#[repr(align(64))]
struct Block([[f32; PANEL]; PANEL]);

struct Product<'a> {
    out: &'a mut [f32],
    left: &'a [f32],
    /// `[PANEL, PANEL]`.
    right: &'a [f32],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { out, left, right } = self;
        let (left, _) = left.as_chunks::<PANEL>();
        let (right, _) = S::as_simd_f32s(right);
        let (out, _) = S::as_mut_simd_f32s(out);
        let whole = PANEL / S::F32_LANES;
        let mut row = 0;
        while row < left.len() {
            let (left, out) = (&left[row..], &mut out[row * whole..]);
            row += match left.len() {
                1 => tile::<S, 1>(simd, out, left, right),
                2 => tile::<S, 2>(simd, out, left, right),
                3..ROWS => tile::<S, 3>(simd, out, left, right),
                _ => tile::<S, ROWS>(simd, out, left, right),
            };
        }
    }
}

/// The first `R` rows; returns `R`.
#[inline(always)]
fn tile<S: Simd, const R: usize>(
    simd: S,
    out: &mut [S::f32s],
    left: &[[f32; PANEL]],
    right: &[S::f32s],
) -> usize {
    // As many vectors at a time as the registers hold beside the operands.
    match S::F32_LANES {
        16.. => add::<S, 4, R>(simd, out, left, right, 0),
        _ => {
            for start in (0..PANEL / S::F32_LANES).step_by(2) {
                add::<S, 2, R>(simd, out, left, right, start);
            }
        }
    }
    R
}

/// `V` vectors of `R` rows, whose sums stay in registers.
#[inline(always)]
fn add<S: Simd, const V: usize, const R: usize>(
    simd: S,
    out: &mut [S::f32s],
    left: &[[f32; PANEL]],
    right: &[S::f32s],
    start: usize,
) {
    let whole = PANEL / S::F32_LANES;
    let Some(left) = left.first_chunk::<R>() else { return };
    let mut sums = [[simd.splat_f32s(0.0); V]; R];
    // Entry by entry: slices would be copied through the stack.
    for (r, sums) in sums.iter_mut().enumerate() {
        for (v, sum) in sums.iter_mut().enumerate() {
            *sum = out[r * whole + start + v];
        }
    }
    for (k, right) in right.chunks_exact(whole).enumerate().take(PANEL) {
        let right = &right[start..start + V];
        for (row, sums) in left.iter().zip(&mut sums) {
            let a = simd.splat_f32s(row[k]);
            for (sum, &b) in sums.iter_mut().zip(right) {
                *sum = simd.mul_add_e_f32s(a, b, *sum);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (v, &sum) in sums.iter().enumerate() {
            out[r * whole + start + v] = sum;
        }
    }
}

/// `[R, N]` by panels `[R, PANEL]`; `None` when the width is not a multiple of [`PANEL`].
pub fn panels_of_rows(values: &[f32], width: usize) -> Option<Vec<Vec<f32>>> {
    let whole = width > 0 && width.is_multiple_of(PANEL) && values.len().is_multiple_of(width);
    let panel = |first: usize| {
        let mut panel = Vec::with_capacity(values.len() / width * PANEL);
        values.chunks_exact(width).for_each(|row| panel.extend_from_slice(&row[first..][..PANEL]));
        panel
    };
    whole.then(|| (0..width).into_par_iter().step_by(PANEL).map(panel).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_sums_in_double_precision() {
        let numbers =
            |count: usize, step: usize| (0..count).map(|i| ((i * step) % 101) as f32 / 50.0 - 1.0).collect();
        for (rows, inner, columns) in [(23, 64, 64), (6, 128, 192), (1, 64, 130), (4, 17 * 64, 64)] {
            let (left, right): (Vec<f32>, Vec<f32>) =
                (numbers(rows * inner, 37), numbers(inner * columns, 53));
            let first = columns - PANEL;
            let mut out = vec![0.5f32; rows * PANEL];
            add_panel(&mut out, &panels_of_rows(&left, inner).unwrap(), &right, first);
            for (i, &got) in out.iter().enumerate() {
                let (r, c) = (i / PANEL, first + i % PANEL);
                let product = |k: usize| left[r * inner + k] as f64 * right[k * columns + c] as f64;
                let expected = 0.5 + (0..inner).map(product).sum::<f64>();
                assert!((got as f64 - expected).abs() < 1e-4, "{rows} {inner} {columns}: {got} {expected}");
            }
        }
        assert!(panels_of_rows(&[0.0; 60], 60).is_none());
    }
}
