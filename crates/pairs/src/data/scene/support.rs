//! The plane that the objects of an annotated image stand on.

use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Hypotheses of three points.
const TRIALS: usize = 100;
/// Points that a hypothesis is judged by at most.
const JUDGES: usize = 600;
/// Random stream of the hypotheses, apart from those of the samples.
const STREAM: u64 = (1 << 63) | 1;

/// Distance from a plane that depth noise explains at `z` metres.
fn tolerance(z: f32) -> f32 {
    0.004 + 0.005 * z * z
}

/// `normal . p = offset`, metres.
#[derive(Clone, Copy, Debug)]
pub struct SupportPlane {
    normal: Vector3<f32>,
    offset: f32,
}

impl SupportPlane {
    /// The plane that most of `points` lie on, by RANSAC and least squares; `None` for fewer than three points or if less than a
    /// tenth of them lie on any. The same points give the same plane.
    pub fn fit(points: &[[f32; 3]]) -> Option<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        rng.set_stream(STREAM);
        if points.len() < 3 {
            return None;
        }
        let draw = |rng: &mut ChaCha8Rng| Vector3::from(points[rng.random_range(0..points.len())]);
        let judges: Vec<[f32; 3]> = (0..JUDGES).map(|_| draw(&mut rng).into()).collect();
        let on = |plane: &Self, among: &[[f32; 3]]| among.iter().filter(|p| plane.contains(**p)).count();
        let mut best: Option<(usize, Self)> = None;
        for _ in 0..TRIALS {
            let [a, b, c] = std::array::from_fn(|_| draw(&mut rng));
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-9) else { continue };
            let plane = Self { normal, offset: normal.dot(&a) };
            let count = on(&plane, &judges);
            if best.is_none_or(|(most, _)| count > most) {
                best = Some((count, plane));
            }
        }
        let (_, mut plane) = best?;
        for _ in 0..3 {
            plane = plane.refitted(points)?;
        }
        (10 * on(&plane, points) >= points.len()).then_some(plane)
    }

    /// Whether a point lies on it within the noise of depth cameras.
    pub fn contains(&self, point: [f32; 3]) -> bool {
        (self.normal.dot(&Vector3::from(point)) - self.offset).abs() < tolerance(point[2])
    }

    /// Least squares of the distances of the points on it.
    fn refitted(&self, points: &[[f32; 3]]) -> Option<Self> {
        let on: Vec<Vector3<f64>> =
            points.iter().filter(|p| self.contains(**p)).map(|p| Vector3::from(p.map(f64::from))).collect();
        if on.len() < 3 {
            return None;
        }
        let mean = on.iter().sum::<Vector3<f64>>() / on.len() as f64;
        let scatter: Matrix3<f64> = on.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        Some(Self { normal: normal.cast(), offset: normal.dot(&mean) as f32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_found_among_a_third_of_others() {
        let on = (0..200).map(|i| [0.01 * (i % 20) as f32, 0.01 * (i / 20) as f32, 0.8]);
        let off = (0..100).map(|i| [0.01 * (i % 10) as f32, 0.3, 0.5 + 0.002 * i as f32]);
        let points: Vec<[f32; 3]> = on.chain(off).collect();
        let plane = SupportPlane::fit(&points).unwrap();
        assert!(
            (plane.normal.z.abs() - 1.0).abs() < 1e-4 && (plane.offset.abs() - 0.8).abs() < 1e-3,
            "{plane:?}"
        );
        assert!(plane.contains([3.0, -2.0, 0.801]) && !plane.contains([0.0, 0.0, 0.82]));
        assert!(SupportPlane::fit(&points[..2]).is_none());
    }
}
