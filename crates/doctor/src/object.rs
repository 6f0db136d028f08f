//! How far away and how large is what a mask shows?

use nalgebra::{Matrix3, Rotation3, Vector3};
use unopose_core::geometry::icosphere;

/// Fewer points have no size.
const FEWEST: usize = 16;
/// Share of the points inside the radius; the others may be flying pixels.
const INSIDE: f64 = 0.95;
/// Points farther from the middle than this many radii are no part of the extent.
const REACH: f64 = 1.6;
/// Share of the points that is cut off at each end of a side.
const CUT: f64 = 0.0025;
/// Points by which a box is turned.
const SAMPLES: usize = 300;
/// Turns about a box's axis that are tried, degrees.
const TURNS: [f64; 6] = [0.0, 15.0, 30.0, 45.0, 60.0, 75.0];
/// Steps of the local search, degrees.
const STEPS: [f64; 5] = [8.0, 4.0, 2.0, 1.0, 0.5];

/// Distance and size of the visible part of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskedObject {
    /// From the camera to the median point, metres.
    pub distance: f64,
    /// Distance from the median point within which 95 % of the points lie, metres.
    pub radius: f64,
    /// Sides of a tight box around the points, the longest first, metres.
    pub extent: [f64; 3],
}

impl MaskedObject {
    /// Of points in a camera's frame, metres; `None` with too few points.
    pub fn measure(points: &[[f32; 3]]) -> Option<Self> {
        if points.len() < FEWEST {
            return None;
        }
        let coordinate = |axis: usize| points.iter().map(|p| f64::from(p[axis])).collect();
        let middle = Vector3::from_fn(|axis, _| quantile(coordinate(axis), 0.5));
        let away = |p: &[f32; 3]| (Vector3::from(p.map(f64::from)) - middle).norm();
        let radius = quantile(points.iter().map(away).collect(), INSIDE);
        let inside: Vec<Vector3<f64>> = points
            .iter()
            .filter(|p| away(p) <= REACH * radius)
            .map(|p| Vector3::from(p.map(f64::from)) - middle)
            .collect();
        Some(Self { distance: middle.norm(), radius, extent: tight_extent(&inside) })
    }
}

/// Sides of the box of least surface around the points, the longest first.
fn tight_extent(points: &[Vector3<f64>]) -> [f64; 3] {
    let step = points.len().div_ceil(SAMPLES).max(1);
    let sample: Vec<Vector3<f64>> = points.iter().copied().step_by(step).collect();
    let surface = |axes: &Matrix3<f64>| {
        let [a, b, c] = sides(&sample, axes);
        a * b + b * c + c * a
    };
    let mut best = (f64::INFINITY, Matrix3::identity());
    // A box has no front: half of the directions are enough.
    for direction in icosphere(1).into_iter().filter(|d| (d.z, d.y, d.x) > (0.0, 0.0, 0.0)) {
        let upright = Rotation3::rotation_between(&Vector3::z(), &direction).unwrap_or_default();
        for turn in TURNS {
            let axes =
                (upright * Rotation3::from_axis_angle(&Vector3::z_axis(), turn.to_radians())).into_inner();
            let value = surface(&axes);
            if value < best.0 {
                best = (value, axes);
            }
        }
    }
    for step in STEPS {
        let mut improved = true;
        while improved {
            improved = false;
            for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
                for angle in [step, -step] {
                    let turn = Rotation3::from_axis_angle(&axis, angle.to_radians());
                    let axes = best.1 * turn.into_inner();
                    let value = surface(&axes);
                    if value < best.0 * (1.0 - 1e-6) {
                        best = (value, axes);
                        improved = true;
                    }
                }
            }
        }
    }
    let mut extent = sides(points, &best.1);
    extent.sort_by(|a, b| b.total_cmp(a));
    extent
}

/// Extents along the columns of `axes`.
fn sides(points: &[Vector3<f64>], axes: &Matrix3<f64>) -> [f64; 3] {
    std::array::from_fn(|i| {
        let axis = axes.column(i);
        let mut along: Vec<f64> = points.iter().map(|p| p.dot(&axis)).collect();
        if along.is_empty() {
            return 0.0;
        }
        let cut = (CUT * along.len() as f64) as usize;
        let last = along.len() - 1;
        let high = *along.select_nth_unstable_by(last - cut, f64::total_cmp).1;
        let low = *along.select_nth_unstable_by(cut, f64::total_cmp).1;
        high - low
    })
}

/// The value below which a share of the values lies; 0 for none.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}
