//! Pose-invariant reference frames of a cloud or a neighbourhood (paper, "Constructing a Pose-invariant Reference
//! Frame"; details as in the release).
//!
//! z is the direction of least spread, its sign from an odd statistic of the heights; x is the weighted mean of the
//! offsets projected to the plane; y = x cross z, so the frame is left-handed as in the release.

use nalgebra::{Matrix3, Vector3};

use super::{procrustes::vector, svd::svd3};

/// Heights within this of the plane are not counted by the release's sign: metres for the global frame, radii for
/// the local ones.
pub(super) const COUNTED_HEIGHT: f64 = 1e-3;

/// The frame of a whole cloud with the quantities it came from.
#[derive(Clone, Debug)]
pub struct GlobalReferenceFrame {
    /// Mean of the points, metres; origin of the frame.
    pub centroid: Vector3<f64>,
    /// Largest distance to the centroid, metres.
    pub radius: f64,
    /// Mean of `x x^T` about the centroid.
    pub covariance: Matrix3<f64>,
    /// Of the covariance, descending.
    pub singular_values: [f64; 3],
    /// Axes of the frame in the cloud's coordinates.
    pub axes: FrameAxes,
    /// Frame coordinates divided by the radius, one per input point.
    pub coordinates: Vec<[f32; 3]>,
}

/// Axes of a reference frame.
#[derive(Clone, Copy, Debug)]
pub struct FrameAxes {
    /// Unit vector along the weighted mean of the offsets in the plane.
    pub x: Vector3<f64>,
    /// x cross z.
    pub y: Vector3<f64>,
    /// Unit normal, the direction of least spread.
    pub z: Vector3<f64>,
    /// Points beyond 1e-3 behind minus in front of the plane, before the sign was chosen; 0 leaves the counted sign
    /// to the convention "largest component positive".
    pub sign_count: i64,
}

impl FrameAxes {
    /// Frame coordinates of an offset from the centre.
    pub fn coordinates(&self, offset: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.x.dot(offset), self.y.dot(offset), self.z.dot(offset))
    }
}

/// Frame coordinates of a cloud in units of its own radius, `[N, 3]`. `counted_sign` is the release's z sign.
pub fn global_reference_frame(points: &[[f32; 3]], counted_sign: bool) -> Vec<[f32; 3]> {
    GlobalReferenceFrame::new(points, counted_sign).coordinates
}

impl GlobalReferenceFrame {
    /// Frame of `points` (metres). A cloud whose points coincide gives coordinates 0.
    pub fn new(points: &[[f32; 3]], counted_sign: bool) -> Self {
        let n = points.len().max(1) as f64;
        let centroid = points.iter().map(vector).sum::<Vector3<f64>>() / n;
        let offsets: Vec<_> = points.iter().map(|p| vector(p) - centroid).collect();
        let radius = offsets.iter().map(Vector3::norm_squared).fold(0.0, f64::max).sqrt();
        let covariance = covariance_of(&offsets, 0);
        let (axes, singular_values) = axes_of(&covariance, &offsets, 0, radius, counted_sign);
        let scale = if radius > 0.0 { 1.0 / radius } else { 0.0 };
        let coordinates = offsets
            .iter()
            .map(|d| axes.coordinates(d) * scale)
            .map(|c| [c.x as f32, c.y as f32, c.z as f32])
            .collect();
        Self { centroid, radius, covariance, singular_values, axes, coordinates }
    }
}

/// Axes of a neighbourhood from its offsets to the centre; the first offset counts `padding` times more.
pub(super) fn local_axes(
    offsets: &[Vector3<f64>],
    padding: usize,
    radius: f64,
    counted_sign: bool,
) -> FrameAxes {
    axes_of(&covariance_of(offsets, padding), offsets, padding, radius, counted_sign).0
}

fn covariance_of(offsets: &[Vector3<f64>], padding: usize) -> Matrix3<f64> {
    let [mut xx, mut xy, mut xz, mut yy, mut yz, mut zz] = [0.0; 6];
    let mut add = |d: &Vector3<f64>, w: f64| {
        xx += w * d.x * d.x;
        xy += w * d.x * d.y;
        xz += w * d.x * d.z;
        yy += w * d.y * d.y;
        yz += w * d.y * d.z;
        zz += w * d.z * d.z;
    };
    offsets.iter().for_each(|d| add(d, 1.0));
    if let Some(first) = offsets.first() {
        add(first, padding as f64);
    }
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) / (offsets.len() + padding).max(1) as f64
}

fn axes_of(
    covariance: &Matrix3<f64>,
    offsets: &[Vector3<f64>],
    padding: usize,
    radius: f64,
    counted_sign: bool,
) -> (FrameAxes, [f64; 3]) {
    let svd = svd3(covariance);
    let largest_positive = svd.v[2][svd.v[2].iamax()] >= 0.0;
    let mut z = if largest_positive { svd.v[2] } else { -svd.v[2] };
    let (mut sign_count, mut cubes) = (0i64, 0.0);
    let mut plane_mean = Vector3::zeros();
    for (i, d) in offsets.iter().enumerate() {
        let multiplicity = if i == 0 { 1 + padding } else { 1 };
        let height = z.dot(d);
        // The statistic is of a = z . (centre - p), the opposite of the height.
        sign_count +=
            multiplicity as i64 * (i64::from(height < -COUNTED_HEIGHT) - i64::from(height > COUNTED_HEIGHT));
        cubes -= multiplicity as f64 * height.powi(3);
        let weight = (radius - d.norm()).powi(2) * height * height;
        plane_mean += (d - z * height) * (weight * multiplicity as f64);
    }
    if if counted_sign { sign_count < 0 } else { cubes < 0.0 } {
        z = -z;
    }
    let x = plane_mean / (plane_mean.norm() + 1e-10);
    (FrameAxes { x, y: x.cross(&z), z, sign_count }, svd.s)
}
