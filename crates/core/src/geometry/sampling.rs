//! Farthest point sampling and the extent of a cloud.

use super::columns::{Columns, LANES};
use crate::simd::vectorised;

/// Indices of `n` points, each the farthest from those before it, starting with point 0. `n` is capped at the
/// number of points.
///
/// Distances are `f32`. Equal distances go to the lowest (bit-reversed (k mod block), k) with
/// block = min(512, 2^floor(log2 N)): the order in which the release's CUDA kernel reduces its threads.
pub fn farthest_point_sampling(points: &[[f32; 3]], n: usize) -> Vec<u32> {
    let count = n.min(points.len());
    if count == 0 {
        return Vec::new();
    }
    let columns = Columns::new(points);
    let bits = points.len().ilog2().min(9);
    // Distance to the nearest chosen point; -1 keeps the padding from being chosen.
    let mut nearest = vec![[f32::INFINITY; LANES]; points.len().div_ceil(LANES)];
    for pad in points.len()..nearest.len() * LANES {
        nearest[pad / LANES][pad % LANES] = -1.0;
    }
    let mut run_best = vec![0.0f32; nearest.len()];
    let mut chosen = Vec::with_capacity(count);
    chosen.push(0u32);
    let mut last = 0usize;
    while chosen.len() < count {
        let mut best = [f32::NEG_INFINITY; LANES];
        vectorised!({
            for (index, (run, run_max)) in nearest.iter_mut().zip(&mut run_best).enumerate() {
                let d = columns.squared_distances(points[last], index);
                let mut lane_max = [f32::NEG_INFINITY; 4];
                for l in 0..LANES {
                    run[l] = if d[l] < run[l] { d[l] } else { run[l] };
                    best[l] = if run[l] > best[l] { run[l] } else { best[l] };
                    lane_max[l % 4] = if run[l] > lane_max[l % 4] { run[l] } else { lane_max[l % 4] };
                }
                *run_max = lane_max[0].max(lane_max[1]).max(lane_max[2].max(lane_max[3]));
            }
        });
        let farthest = best.into_iter().fold(f32::NEG_INFINITY, f32::max);
        last = nearest
            .iter()
            .zip(&run_best)
            .enumerate()
            .filter(|(_, (_, run_max))| **run_max == farthest)
            .flat_map(|(r, (run, _))| (0..LANES).filter(|&l| run[l] == farthest).map(move |l| r * LANES + l))
            .min_by_key(|&k| (reversed_thread(k, bits), k))
            .unwrap_or(0);
        chosen.push(last as u32);
    }
    chosen
}

/// The low `bits` bits of `k` in reverse order.
fn reversed_thread(k: usize, bits: u32) -> u32 {
    if bits == 0 { 0 } else { ((k as u32) << (32 - bits)).reverse_bits() }
}

/// Mean of the points and the largest distance to it; zeros for an empty cloud.
pub fn radius_about_mean(points: &[[f32; 3]]) -> ([f32; 3], f32) {
    let n = points.len().max(1) as f64;
    let sum = points.iter().fold([0.0f64; 3], |s, p| std::array::from_fn(|i| s[i] + p[i] as f64));
    let mean = sum.map(|s| s / n);
    let squared = points
        .iter()
        .map(|p| (0..3).map(|i| (p[i] as f64 - mean[i]).powi(2)).sum::<f64>())
        .fold(0.0, f64::max);
    (mean.map(|m| m as f32), squared.sqrt() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_follow_the_bit_reversed_thread() {
        // Four points at equal distance from point 0: threads 1, 2, 3 of a block of 4; 2 has the lowest reversal.
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(farthest_point_sampling(&points, 2), [0, 2]);
        assert_eq!(farthest_point_sampling(&points, 9).len(), 4);
        assert!(farthest_point_sampling(&[], 3).is_empty());
    }

    #[test]
    fn radius_of_a_square() {
        let square = [[1.0, 1.0, 5.0], [3.0, 1.0, 5.0], [1.0, 3.0, 5.0], [3.0, 3.0, 5.0]];
        let (mean, radius) = radius_about_mean(&square);
        assert_eq!(mean, [2.0, 2.0, 5.0]);
        assert!((radius - 2f32.sqrt()).abs() < 1e-6);
    }
}
