//! How well two clouds lie on each other under a pose, seen from both.

use super::{Pose, columns::Columns};

/// Points of each cloud whose distances count; they come in random or farthest-point order, so the first are spread out.
const COUNTED: usize = 128;
/// Distance at which a point counts exp(-1/2), radii. Of 0.03, 0.05 and 0.08 the one that picks right hypotheses most
/// often on synthetic pairs.
const SPREAD: f32 = 0.05;

/// Two clouds in radii, ready for many poses.
pub struct MutualFit<'a> {
    query: &'a [[f32; 3]],
    reference: &'a [[f32; 3]],
    query_columns: Columns,
    reference_columns: Columns,
}

impl<'a> MutualFit<'a> {
    /// From the dense points of both clouds, `[N, 3]` and `[M, 3]`, divided by the object's radius.
    pub fn new(query: &'a [[f32; 3]], reference: &'a [[f32; 3]]) -> Self {
        let (query_columns, reference_columns) = (Columns::new(query), Columns::new(reference));
        Self { query, reference, query_columns, reference_columns }
    }

    /// Mean weight of the query's points by their distance to the moved reference, times that of the reference's points
    /// by their distance to the query: 1 when all lie on each other.
    pub fn score(&self, t_query_reference: &Pose) -> f64 {
        let [[query], [reference]] = self.parts(t_query_reference, [SPREAD]);
        query * reference
    }

    /// Mean weights of the query's points and of the reference's for each of `spreads`, the distance at which a point counts
    /// exp(-1/2), radii.
    pub fn parts<const N: usize>(&self, t_query_reference: &Pose, spreads: [f32; N]) -> [[f64; N]; 2] {
        [
            fit(self.query, &t_query_reference.inverse(), &self.reference_columns, spreads),
            fit(self.reference, t_query_reference, &self.query_columns, spreads),
        ]
    }
}

fn fit<const N: usize>(points: &[[f32; 3]], pose: &Pose, other: &Columns, spreads: [f32; N]) -> [f64; N] {
    let counted = &points[..points.len().min(COUNTED)];
    let mut sums = [0.0; N];
    for p in counted {
        let squared = other.nearest_squared(pose.transform_f32(p));
        for (sum, spread) in sums.iter_mut().zip(spreads) {
            *sum += f64::from((-squared / (2.0 * spread * spread)).exp());
        }
    }
    sums.map(|sum| sum / counted.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    #[test]
    fn one_on_each_other_and_falls_with_the_distance() {
        let reference: Vec<[f32; 3]> = (0..100).map(|i| [(i % 10) as f32, (i / 10) as f32, 0.0]).collect();
        let shift = |x: f64| Pose::new(Matrix3::identity(), Vector3::new(0.3, x, -0.2));
        let query: Vec<[f32; 3]> = reference.iter().map(|p| shift(0.0).transform_f32(p)).collect();
        let fit = MutualFit::new(&query, &reference);
        assert!((fit.score(&shift(0.0)) - 1.0).abs() < 1e-6);
        // Every point is 0.05 from its nearest one: exp(-1/2) on both sides.
        assert!((fit.score(&shift(0.05)) - (-1.0f64).exp()).abs() < 1e-4);
        // Half of the reference seen: the query lies on it, half of it does not lie on the query.
        let half = MutualFit::new(&query[..50], &reference);
        assert!((half.score(&shift(0.0)) - 0.5).abs() < 1e-6);
        assert_eq!(MutualFit::new(&[], &reference).score(&shift(0.0)), 0.0);
    }
}
