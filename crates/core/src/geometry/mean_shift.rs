//! Mean shift: the modes of a set of points, and which point belongs to which.
//!
//! With the flat kernel: a mode is where the mean of all points within the bandwidth is itself. Points are summed in cubes of
//! a third of the bandwidth first, so the cost depends on the space that they fill and not on their number.
//! (Comaniciu and Meer, "Mean Shift: A Robust Approach Toward Feature Space Analysis", 2002.)

use std::collections::BTreeMap;

/// Side of a cube, bandwidths.
const CUBE: f32 = 1.0 / 3.0;
/// Iterations of a seed.
const ITERATIONS: usize = 40;
/// Change that ends the iterations, bandwidths.
const CONVERGED: f32 = 1e-3;
/// No mode: the point is too far from all of them.
pub const NO_MODE: u32 = u32::MAX;

/// The modes and the points' assignment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeanShift {
    /// Heaviest first; no two are nearer to each other than the bandwidth.
    pub modes: Vec<[f32; 3]>,
    /// Number of the nearest mode within 1.5 bandwidths of each point, else [`NO_MODE`].
    pub assignment: Vec<u32>,
}

/// Modes of `points` with at least `least` points within `bandwidth` (in the unit of the points).
pub fn mean_shift(points: &[[f32; 3]], bandwidth: f32, least: usize) -> MeanShift {
    if !(bandwidth.is_finite() && bandwidth > 0.0) {
        return MeanShift { modes: Vec::new(), assignment: vec![NO_MODE; points.len()] };
    }
    let cubes = Cubes::new(points, bandwidth);
    let mut found: Vec<(usize, [f32; 3])> = Vec::new();
    for &(count, sum) in cubes.cells.values() {
        let mut mode = sum.map(|v| (v / count as f64) as f32);
        let mut mass = 0;
        for _ in 0..ITERATIONS {
            let (within, mean) = cubes.mean_around(mode);
            mass = within;
            let moved = distance(mode, mean);
            mode = mean;
            if moved < CONVERGED * bandwidth {
                break;
            }
        }
        if mass >= least {
            found.push((mass, mode));
        }
    }
    // Stable: of equal ones the first in the order of the cubes.
    found.sort_by_key(|(mass, _)| std::cmp::Reverse(*mass));
    let mut modes: Vec<[f32; 3]> = Vec::new();
    for (_, mode) in found {
        if modes.iter().all(|&kept| distance(kept, mode) >= bandwidth) {
            modes.push(mode);
        }
    }
    let nearest = |point: &[f32; 3]| {
        let all = modes.iter().enumerate().map(|(i, &mode)| (distance(*point, mode), i as u32));
        let best = all.min_by(|a, b| a.0.total_cmp(&b.0));
        best.filter(|(d, _)| *d <= 1.5 * bandwidth).map_or(NO_MODE, |(_, i)| i)
    };
    let assignment = points.iter().map(nearest).collect();
    MeanShift { modes, assignment }
}

/// Number and sum of the points in each cube that has any.
struct Cubes {
    side: f32,
    bandwidth: f32,
    cells: BTreeMap<[i32; 3], (usize, [f64; 3])>,
}

impl Cubes {
    fn new(points: &[[f32; 3]], bandwidth: f32) -> Self {
        let mut cubes = Self { side: CUBE * bandwidth, bandwidth, cells: BTreeMap::new() };
        for point in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let (count, sum) = cubes.cells.entry(cubes.index(*point)).or_default();
            *count += 1;
            sum.iter_mut().zip(point).for_each(|(s, &v)| *s += f64::from(v));
        }
        cubes
    }

    fn index(&self, point: [f32; 3]) -> [i32; 3] {
        point.map(|v| (v / self.side).floor() as i32)
    }

    /// Number and mean of the points of the cubes whose own mean is within the bandwidth; the place itself where there is none.
    fn mean_around(&self, place: [f32; 3]) -> (usize, [f32; 3]) {
        let reach = (1.0 / CUBE).ceil() as i32 + 1;
        let [x, y, z] = self.index(place);
        let (mut count, mut sum) = (0, [0.0f64; 3]);
        for i in x.saturating_sub(reach)..=x.saturating_add(reach) {
            for j in y.saturating_sub(reach)..=y.saturating_add(reach) {
                let row = [i, j, z.saturating_sub(reach)]..=[i, j, z.saturating_add(reach)];
                for (_, (n, s)) in self.cells.range(row) {
                    let mean = s.map(|v| (v / *n as f64) as f32);
                    if distance(mean, place) <= self.bandwidth {
                        count += n;
                        sum.iter_mut().zip(s).for_each(|(a, b)| *a += b);
                    }
                }
            }
        }
        if count == 0 { (0, place) } else { (count, sum.map(|v| (v / count as f64) as f32)) }
    }
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_clouds_have_their_means_as_modes() {
        // Two symmetric clouds, 10 cm apart, of 125 and 27 points, and a single point far away.
        let cloud = |centre: [f32; 3], half: i32| -> Vec<[f32; 3]> {
            let steps = || -half..=half;
            let at = |i: i32, j: i32, k: i32| {
                [centre[0] + 2e-3 * i as f32, centre[1] + 2e-3 * j as f32, centre[2] + 2e-3 * k as f32]
            };
            steps().flat_map(|i| steps().flat_map(move |j| steps().map(move |k| at(i, j, k)))).collect()
        };
        let mut points = cloud([0.1, 0.0, 0.8], 1);
        points.extend(cloud([0.0, 0.0, 0.8], 2));
        points.push([0.5, 0.5, 0.5]);
        let found = mean_shift(&points, 0.03, 5);
        assert_eq!(found.modes.len(), 2);
        assert!(distance(found.modes[0], [0.0, 0.0, 0.8]) < 1e-5, "{:?}", found.modes);
        assert!(distance(found.modes[1], [0.1, 0.0, 0.8]) < 1e-5, "{:?}", found.modes);
        let expected: Vec<u32> = [vec![1; 27], vec![0; 125], vec![NO_MODE]].concat();
        assert_eq!(found.assignment, expected);
        // Within one bandwidth they are one, at the mean of all.
        let all = mean_shift(&points, 0.2, 5);
        assert_eq!(all.modes.len(), 1);
        assert!((all.modes[0][0] - 0.1 * 27.0 / 152.0).abs() < 1e-4, "{:?}", all.modes);
    }

    #[test]
    fn nothing_has_no_modes() {
        assert_eq!(mean_shift(&[], 0.1, 1), MeanShift::default());
        assert_eq!(mean_shift(&[[0.0; 3]], 0.0, 1).assignment, [NO_MODE]);
        assert_eq!(mean_shift(&[[f32::NAN; 3]], 0.1, 1).assignment, [NO_MODE]);
    }
}
