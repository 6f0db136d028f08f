//! The structure embedding from tables of its mapped sinusoids, and the gradient to the tables.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::simd::vectorised;

use super::tape::{Gradient, Input, Values, plain, record};

/// Pairs of points per parallel task.
const PAIRS: usize = 64;
/// Channels per parallel task of the gradient.
const COLUMNS: usize = 32;

pub fn interpolated_embedding(
    tables: &[Tensor<2>; 2],
    distances: &Tensor<1>,
    angles: &Tensor<2>,
) -> Option<Tensor<2>> {
    let [n, k] = angles.dims();
    let [_, width] = tables[0].dims();
    let (distances, angles) = (Values::of(distances)?, Values::of(angles)?);
    if let (Some(d), Some(a)) = (Values::of(&tables[0]), Values::of(&tables[1])) {
        let (d, a): (&[f32], &[f32]) = (&d, &a);
        let mut rows = vec![0.0f32; n * width];
        let inputs = distances.par_chunks(PAIRS).zip(angles.par_chunks(PAIRS * k));
        rows.par_chunks_mut(PAIRS * width).zip(inputs).for_each(|(rows, (distances, angles))| {
            vectorised!({
                let pairs = distances.iter().zip(angles.chunks_exact(k));
                for (row, (&distance, angles)) in rows.chunks_exact_mut(width).zip(pairs) {
                    match *angles {
                        [x, y, z] => largest_of_three(row, a, [x, y, z], d, distance),
                        _ => {
                            largest(row, a, angles);
                            add(row, d, distance);
                        }
                    }
                }
            });
        });
        return Some(plain(rows, [n, width]));
    }
    let inputs = [Input::of(&tables[0])?, Input::of(&tables[1])?];
    let [d, a] = [&inputs[0].values, &inputs[1].values].map(|values| -> &[f32] { values });
    let (mut rows, mut winners) = (vec![0.0; n * width], vec![0u8; n * width]);
    let outputs = rows.par_chunks_mut(PAIRS * width).zip(winners.par_chunks_mut(PAIRS * width));
    outputs.zip(distances.par_chunks(PAIRS).zip(angles.par_chunks(PAIRS * k))).for_each(
        |((rows, winners), (distances, angles))| {
            vectorised!({
                let outputs = rows.chunks_exact_mut(width).zip(winners.chunks_exact_mut(width));
                for ((row, winners), (&distance, angles)) in
                    outputs.zip(distances.iter().zip(angles.chunks_exact(k)))
                {
                    largest_with_slot(row, winners, a, angles);
                    add(row, d, distance);
                }
            });
        },
    );
    record(inputs, rows, [n, width], |[d, a], _| Embedding {
        distances,
        angles,
        winners,
        entries: [d.len() / width, a.len() / width],
        width,
        k,
    })
}

/// Table rows below and above position `x` and the weight of the latter.
#[inline(always)]
fn bracket(table: &[f32], width: usize, x: f32) -> (&[f32], &[f32], f32) {
    let low = x as usize;
    let rows = &table[low * width..(low + 2) * width];
    (&rows[..width], &rows[width..], x - low as f32)
}

#[inline(always)]
fn add(row: &mut [f32], table: &[f32], x: f32) {
    let (below, above, fraction) = bracket(table, row.len(), x);
    for ((value, &b), &a) in row.iter_mut().zip(below).zip(above) {
        *value += b + (a - b) * fraction;
    }
}

#[inline(always)]
fn largest(row: &mut [f32], table: &[f32], positions: &[f32]) {
    row.fill(f32::NEG_INFINITY);
    for &x in positions {
        let (below, above, fraction) = bracket(table, row.len(), x);
        for ((value, &b), &a) in row.iter_mut().zip(below).zip(above) {
            let y = b + (a - b) * fraction;
            *value = if y > *value { y } else { *value };
        }
    }
}

/// [`largest`] of three positions and [`add`] in one pass over the row.
#[inline(always)]
fn largest_of_three(row: &mut [f32], angles: &[f32], positions: [f32; 3], distances: &[f32], distance: f32) {
    let width = row.len();
    let [x, y, z] = positions.map(|position| bracket(angles, width, position));
    let between = |(below, above): (&f32, &f32), fraction: f32| below + (above - below) * fraction;
    let larger = |a: f32, b: f32| if b > a { b } else { a };
    let (below, above, fraction) = bracket(distances, width, distance);
    let of_angles = x.0.iter().zip(x.1).zip(y.0.iter().zip(y.1)).zip(z.0.iter().zip(z.1));
    for ((value, ((of_x, of_y), of_z)), of_distance) in
        row.iter_mut().zip(of_angles).zip(below.iter().zip(above))
    {
        let largest = larger(larger(between(of_x, x.2), between(of_y, y.2)), between(of_z, z.2));
        *value = largest + between(of_distance, fraction);
    }
}

/// [`largest`] and which position it came from; the first of equal ones.
#[inline(always)]
fn largest_with_slot(row: &mut [f32], slots: &mut [u8], table: &[f32], positions: &[f32]) {
    row.fill(f32::NEG_INFINITY);
    for (slot, &x) in (0u8..).zip(positions) {
        let (below, above, fraction) = bracket(table, row.len(), x);
        for (((value, winner), &b), &a) in row.iter_mut().zip(&mut *slots).zip(below).zip(above) {
            let y = b + (a - b) * fraction;
            let better = y > *value;
            *value = if better { y } else { *value };
            *winner = if better { slot } else { *winner };
        }
    }
}

#[derive(Clone, Debug)]
struct Embedding {
    distances: Values,
    angles: Values,
    winners: Vec<u8>,
    /// Rows of each table.
    entries: [usize; 2],
    width: usize,
    k: usize,
}

impl Gradient<2> for Embedding {
    /// Every pair's gradient goes to the two rows around its distance and, per channel, around the largest angle's
    /// position. Tasks own channels, so the order of the sums is fixed.
    fn gradients(&self, output: &[f32], _: [bool; 2]) -> [(Vec<f32>, Vec<usize>); 2] {
        let width = self.width;
        let starts: Vec<usize> = (0..width).step_by(COLUMNS).collect();
        let parts: Vec<[Vec<f32>; 2]> = starts
            .par_iter()
            .map(|&start| {
                let columns = COLUMNS.min(width - start);
                let mut sums = self.entries.map(|entries| vec![0.0f32; entries * columns]);
                vectorised!(self.add_columns(&mut sums, output, start, columns));
                sums
            })
            .collect();
        [0, 1].map(|table| {
            let entries = self.entries[table];
            let mut whole = vec![0.0; entries * width];
            for (part, &start) in parts.iter().zip(&starts) {
                let columns = COLUMNS.min(width - start);
                let rows = whole.chunks_exact_mut(width).zip(part[table].chunks_exact(columns));
                rows.for_each(|(row, sums)| row[start..start + columns].copy_from_slice(sums));
            }
            (whole, vec![entries, width])
        })
    }
}

impl Embedding {
    #[inline(always)]
    fn add_columns(&self, sums: &mut [Vec<f32>; 2], output: &[f32], start: usize, columns: usize) {
        let [to_d, to_a] = sums;
        let rows = output.chunks_exact(self.width).zip(self.winners.chunks_exact(self.width));
        let pairs = self.distances.iter().zip(self.angles.chunks_exact(self.k));
        for ((row, winners), (&distance, angles)) in rows.zip(pairs) {
            let row = &row[start..start + columns];
            let low = distance as usize;
            let fraction = distance - low as f32;
            let (below, above) = to_d[low * columns..(low + 2) * columns].split_at_mut(columns);
            for ((b, a), &g) in below.iter_mut().zip(above).zip(row) {
                let share = g * fraction;
                *b += g - share;
                *a += share;
            }
            for (slot, &angle) in (0u8..).zip(angles) {
                let low = angle as usize;
                let fraction = angle - low as f32;
                let (below, above) = to_a[low * columns..(low + 2) * columns].split_at_mut(columns);
                let gradients = row.iter().zip(&winners[start..start + columns]);
                for ((b, a), (&g, &winner)) in below.iter_mut().zip(above).zip(gradients) {
                    let g = if winner == slot { g } else { 0.0 };
                    let share = g * fraction;
                    *b += g - share;
                    *a += share;
                }
            }
        }
    }
}
