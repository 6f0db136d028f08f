//! The end of a matching stage without gradients: tokens to cosines.

use burn::{nn::Linear, tensor::Tensor};
use rayon::prelude::*;
use unopose_core::simd::{map_rows, sum, vectorised};

use super::{
    rows::{Map, transposed},
    tape::{Values, plain},
};

/// Rows per task.
const ROWS: usize = 96;
/// Columns of a product that are worked on at a time, so that they stay in a core's cache.
const COLUMNS: usize = 512;
/// Columns are padded to whole vectors of a tile.
const LANES: usize = 64;

/// `factor` times the cosines of mapped tokens, `[B, N, K]` and `[B, M, K]` to `[B, N, M]`; norms are at least 1e-12.
pub fn cosines(a: &Tensor<3>, b: &Tensor<3>, map: &Linear, factor: f32) -> Option<Tensor<3>> {
    let ([batch, n, _], [_, m, _]) = (a.dims(), b.dims());
    let (a, b, map) = (Values::of(a)?, Values::of(b)?, Map::of(map)?);
    let width = map.outputs();
    let (a, b) = (unit_rows(&a, &map, factor), unit_rows(&b, &map, 1.0));
    let mut out = vec![0.0f32; batch * n * m];
    for (item, out) in out.chunks_exact_mut((n * m).max(1)).enumerate() {
        // Columns of the other side `[C, columns]`, padded ones zero.
        let blocks: Vec<Vec<f32>> = b[item * m * width..][..m * width]
            .par_chunks(COLUMNS * width)
            .map(|rows| {
                let mut padded = rows.to_vec();
                padded.resize((rows.len() / width).next_multiple_of(LANES) * width, 0.0);
                transposed(&padded, width)
            })
            .collect();
        let rows = a[item * n * width..][..n * width].par_chunks(ROWS * width);
        out.par_chunks_mut(ROWS * m).zip(rows).for_each(|(out, rows)| {
            let mut products = vec![0.0f32; ROWS * COLUMNS];
            for (block, columns) in blocks.iter().enumerate() {
                let padded = columns.len() / width;
                let products = &mut products[..rows.len() / width * padded];
                map_rows(products, rows, columns, &[0.0; COLUMNS][..padded], false);
                let (first, count) = (block * COLUMNS, padded.min(m - block * COLUMNS));
                for (out, products) in out.chunks_exact_mut(m).zip(products.chunks_exact(padded)) {
                    out[first..first + count].copy_from_slice(&products[..count]);
                }
            }
        });
    }
    Some(plain(out, [batch, n, m]))
}

/// Mapped rows of length `factor`.
fn unit_rows(x: &[f32], map: &Map, factor: f32) -> Vec<f32> {
    let width = map.outputs();
    let mut y = vec![0.0f32; x.len() / map.inputs() * width];
    y.par_chunks_mut(ROWS * width).zip(x.par_chunks(ROWS * map.inputs())).for_each(|(y, x)| {
        map.write(y, x);
        vectorised!({
            for row in y.chunks_exact_mut(width) {
                let scale = factor / sum(row, |y| y * y).sqrt().max(1e-12);
                row.iter_mut().for_each(|y| *y *= scale);
            }
        });
    });
    y
}
