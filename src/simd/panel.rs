//! Matrix products of many columns: tasks compute panels of [`PANEL`] columns on their own, so that every part of the
//! right matrix is read once, by one core, and stays in its cache while all rows of the left one pass.

use pulp::{Arch, Simd, WithSimd};

use super::vectorised;

/// Columns of a panel, as wide as the heads of the usual vision transformers.
pub const PANEL: usize = 64;
/// Rows of the left matrix that are multiplied together.
const ROWS: usize = 6;
/// Blocks of the right matrix that are packed together: a quarter of a megabyte.
const DEPTH: usize = 16;

/// A matrix `[R, K]` by blocks of [`PANEL`] columns: row `r` of a block lies at `r * stride`.
pub struct Blocks<'a> {
    blocks: Vec<&'a [f32]>,
    stride: usize,
    rows: usize,
}

impl<'a> Blocks<'a> {
    /// Of a row-major matrix; `None` when its width is not a multiple of [`PANEL`].
    pub fn of_rows(values: &'a [f32], width: usize) -> Option<Self> {
        let whole = width > 0 && width.is_multiple_of(PANEL) && values.len().is_multiple_of(width);
        whole.then(|| Self {
            blocks: (0..width).step_by(PANEL).map(|first| values.get(first..).unwrap_or_default()).collect(),
            stride: width,
            rows: values.len() / width,
        })
    }

    /// Of panels `[R, PANEL]`.
    pub fn of_panels(panels: &'a [Vec<f32>]) -> Self {
        let rows = panels.iter().map(|panel| panel.len() / PANEL).min().unwrap_or(0);
        Self { blocks: panels.iter().map(Vec::as_slice).collect(), stride: PANEL, rows }
    }

    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of the matrix.
    pub fn width(&self) -> usize {
        self.blocks.len() * PANEL
    }
}

/// `out [R, PANEL] += left [R, K] right [K, N]` for the columns of `right` from `first` on.
///
/// # Panics
/// When the lengths do not fit together.
pub fn add_panel(out: &mut [f32], left: &Blocks, right: &[f32], first: usize) {
    let columns = right.len() / left.width().max(1);
    assert_eq!(out.len(), left.rows * PANEL, "{} rows of {PANEL}", left.rows);
    assert!(
        right.len() == left.width() * columns && first + PANEL <= columns,
        "{first} of {columns} columns"
    );
    let mut packed: Vec<[f32; PANEL]> = Vec::with_capacity(DEPTH.min(left.blocks.len()) * PANEL);
    let depths = left.blocks.chunks(DEPTH).zip(right.chunks(DEPTH * PANEL * columns));
    for (blocks, right) in depths {
        packed.clear();
        // As vectors: the weights come from memory, and calls of memcpy in between keep few of the loads in flight.
        vectorised(|| {
            packed.extend(right.chunks_exact(columns).filter_map(|row| row[first..].first_chunk()).copied())
        });
        Arch::new().dispatch(Product { out, blocks, stride: left.stride, right: packed.as_flattened() });
    }
}

struct Product<'a> {
    out: &'a mut [f32],
    blocks: &'a [&'a [f32]],
    stride: usize,
    /// `[K, PANEL]`.
    right: &'a [f32],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { out, blocks, stride, right } = self;
        let (right, _) = S::as_simd_f32s(right);
        let (out, _) = S::as_mut_simd_f32s(out);
        let whole = PANEL / S::F32_LANES;
        let rows = out.len() / whole;
        // As many vectors at a time as the registers hold beside the operands.
        let mut row = 0;
        while row < rows {
            let tile = Tile { blocks, stride, right, row, whole };
            row += match rows - row {
                1 => tile.columns::<S, 1>(simd, out),
                2 => tile.columns::<S, 2>(simd, out),
                3..ROWS => tile.columns::<S, 3>(simd, out),
                _ => tile.columns::<S, ROWS>(simd, out),
            };
        }
    }
}

/// A few rows times a panel.
struct Tile<'a, V> {
    blocks: &'a [&'a [f32]],
    stride: usize,
    right: &'a [V],
    row: usize,
    /// Vectors per row of the panel.
    whole: usize,
}

impl<T: Copy> Tile<'_, T> {
    /// `R` rows; returns `R`.
    #[inline(always)]
    fn columns<S: Simd<f32s = T>, const R: usize>(&self, simd: S, out: &mut [T]) -> usize {
        match S::F32_LANES {
            16.. => self.add::<S, 4, R>(simd, out, 0),
            _ => {
                for start in (0..self.whole).step_by(2) {
                    self.add::<S, 2, R>(simd, out, start);
                }
            }
        }
        R
    }

    /// `V` vectors, whose sums stay in registers.
    #[inline(always)]
    fn add<S: Simd<f32s = T>, const V: usize, const R: usize>(&self, simd: S, out: &mut [T], start: usize) {
        let mut sums = [[simd.splat_f32s(0.0); V]; R];
        for (r, sums) in sums.iter_mut().enumerate() {
            sums.copy_from_slice(&out[(self.row + r) * self.whole + start..][..V]);
        }
        for (block, right) in self.blocks.iter().zip(self.right.chunks_exact(PANEL * self.whole)) {
            let mut rows = [&[0.0f32; PANEL]; R];
            for (r, row) in rows.iter_mut().enumerate() {
                if let Some(values) = block[(self.row + r) * self.stride..].first_chunk() {
                    *row = values;
                }
            }
            for (k, right) in right.chunks_exact(self.whole).enumerate() {
                let right = &right[start..start + V];
                for (row, sums) in rows.iter().zip(&mut sums) {
                    let a = simd.splat_f32s(row[k]);
                    for (sum, &b) in sums.iter_mut().zip(right) {
                        *sum = simd.mul_add_e_f32s(a, b, *sum);
                    }
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            out[(self.row + r) * self.whole + start..][..V].copy_from_slice(sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_of_rows_and_of_panels_agree_with_sums_in_double_precision() {
        let numbers =
            |count: usize, step: usize| (0..count).map(|i| ((i * step) % 101) as f32 / 50.0 - 1.0).collect();
        for (rows, inner, columns) in [(23, 64, 64), (6, 128, 192), (1, 64, 130), (4, 17 * 64, 64)] {
            let (left, right): (Vec<f32>, Vec<f32>) =
                (numbers(rows * inner, 37), numbers(inner * columns, 53));
            let panels: Vec<Vec<f32>> = (0..inner)
                .step_by(PANEL)
                .map(|first| {
                    left.chunks_exact(inner).flat_map(|row| &row[first..][..PANEL]).copied().collect()
                })
                .collect();
            let first = columns - PANEL;
            for left_blocks in [Blocks::of_rows(&left, inner).unwrap(), Blocks::of_panels(&panels)] {
                let mut out = vec![0.5f32; rows * PANEL];
                add_panel(&mut out, &left_blocks, &right, first);
                for (i, &got) in out.iter().enumerate() {
                    let (r, c) = (i / PANEL, first + i % PANEL);
                    let product = |k: usize| left[r * inner + k] as f64 * right[k * columns + c] as f64;
                    let expected = 0.5 + (0..inner).map(product).sum::<f64>();
                    assert!(
                        (got as f64 - expected).abs() < 1e-4,
                        "{rows} {inner} {columns}: {got} {expected}"
                    );
                }
            }
        }
        assert!(Blocks::of_rows(&[0.0; 60], 60).is_none());
    }
}
