//! Dot products of a few rows with each of many, which come from memory.

use pulp::{Arch, Simd, WithSimd};

use super::dot;

/// Rows of the left matrix that are multiplied together, and of the right one.
const LEFT: usize = 4;
const RIGHT: usize = 4;

/// `out[h][m] = left[h] right[m]` for rows `[K]` of `left` and all rows of `right` `[M, K]`.
///
/// # Panics
/// When the lengths do not fit together.
pub fn row_products(out: &mut [&mut [f32]], left: &[&[f32]], right: &[f32]) {
    let inner = left.first().map_or(0, |row| row.len());
    let rows = right.len() / inner.max(1);
    assert!(left.iter().all(|row| row.len() == inner) && right.len() == rows * inner, "rows of {inner}");
    assert!(
        out.len() == left.len() && out.iter().all(|out| out.len() == rows),
        "{} rows of {rows}",
        left.len()
    );
    if rows > 0 {
        Arch::new().dispatch(Products { out, left, right });
    }
}

struct Products<'a, 'b> {
    out: &'a mut [&'b mut [f32]],
    left: &'a [&'a [f32]],
    right: &'a [f32],
}

impl WithSimd for Products<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { out, left, right } = self;
        for (out, left) in out.chunks_mut(LEFT).zip(left.chunks(LEFT)) {
            let inner = left[0].len();
            match (out.first_chunk_mut(), left.first_chunk()) {
                // As many sums as the registers hold beside the operands.
                (Some(out), Some(left)) if inner.is_multiple_of(S::F32_LANES) && S::F32_LANES >= 16 => {
                    from_memory::<S, RIGHT>(simd, out, left, right);
                }
                (Some(out), Some(left)) if inner.is_multiple_of(S::F32_LANES) => {
                    from_memory::<S, 2>(simd, out, left, right);
                }
                _ => {
                    for (out, left) in out.iter_mut().zip(left) {
                        let rows = out.iter_mut().zip(right.chunks_exact(inner));
                        rows.for_each(|(o, right)| *o = dot(left, right));
                    }
                }
            }
        }
    }
}

/// All rows of `right`, `R` at a time.
#[inline(always)]
fn from_memory<S: Simd, const R: usize>(
    simd: S,
    out: &mut [&mut [f32]; LEFT],
    left: &[&[f32]; LEFT],
    right: &[f32],
) {
    let left = left.map(|row| S::as_simd_f32s(row).0);
    let (right, _) = S::as_simd_f32s(right);
    let whole = left[0].len();
    let (mut row, mut rest) = (0, right);
    while !rest.is_empty() {
        let rows = rest.len() / whole;
        // All of the next rows are asked for at once: while they are multiplied, one waits for another.
        let mut sum = simd.splat_f32s(0.0);
        for &next in rest.iter().skip(R * whole).take(R * whole) {
            sum = simd.add_f32s(sum, next);
        }
        std::hint::black_box(sum);
        let done = if rows < R {
            add::<S, 1>(simd, out, left, rest, row)
        } else {
            add::<S, R>(simd, out, left, rest, row)
        };
        (row, rest) = (row + done, &rest[done * whole..]);
    }
}

/// The first `R` rows of `right`, whose sums stay in registers and go to `out[..][row..]`; returns `R`.
#[inline(always)]
fn add<S: Simd, const R: usize>(
    simd: S,
    out: &mut [&mut [f32]; LEFT],
    left: [&[S::f32s]; LEFT],
    right: &[S::f32s],
    row: usize,
) -> usize {
    let whole = left[0].len();
    let mut sums = [[simd.splat_f32s(0.0); R]; LEFT];
    for k in 0..whole {
        for (left, sums) in left.iter().zip(&mut sums) {
            for (r, sum) in sums.iter_mut().enumerate() {
                *sum = simd.mul_add_e_f32s(left[k], right[r * whole + k], *sum);
            }
        }
    }
    for (out, sums) in out.iter_mut().zip(sums) {
        for (r, sum) in sums.into_iter().enumerate() {
            out[row + r] = simd.reduce_sum_f32s(sum);
        }
    }
    R
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_sums_in_double_precision() {
        let numbers = |count: usize, step: usize| -> Vec<f32> {
            (0..count).map(|i| ((i * step) % 101) as f32 / 50.0 - 1.0).collect()
        };
        for (heads, rows, inner) in
            [(4, 13, 64), (4, 8, 256), (8, 3, 32), (3, 5, 48), (4, 7, 45), (6, 1, 16), (2, 0, 8)]
        {
            let (left, right) = (numbers(heads * inner, 37), numbers(rows * inner, 53));
            let mut out = vec![f32::NAN; heads * rows];
            let mut by_head: Vec<&mut [f32]> = out.chunks_exact_mut(rows.max(1)).collect();
            by_head.resize_with(heads, Default::default);
            row_products(&mut by_head, &left.chunks_exact(inner).collect::<Vec<_>>(), &right);
            for (i, &got) in out.iter().enumerate() {
                let (h, m) = (i / rows, i % rows);
                let product = |k: usize| left[h * inner + k] as f64 * right[m * inner + k] as f64;
                let expected = (0..inner).map(product).sum::<f64>();
                assert!((got as f64 - expected).abs() < 2e-5, "{heads} {rows} {inner}: {got} {expected}");
            }
        }
    }
}
