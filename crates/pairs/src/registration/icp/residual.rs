//! How well two surfaces lie on each other.

use unopose_core::geometry::Pose;

use super::super::surface::{Surface, vector};

/// Share of the query's points, those that fit best, that the residual counts.
const TRIM: f64 = 0.7;

/// Mean of the smallest distances of the query's points to the reference surface: across the nearest point's tangent
/// plane, and along it what the spacing of the points does not explain. Metres.
pub fn residual(query: &Surface, reference: &Surface, t_reference_query: &Pose) -> f64 {
    let mut distances: Vec<f64> = query
        .points
        .iter()
        .map(|q| {
            let p = t_reference_query.rotation * vector(q) + t_reference_query.translation;
            let nearest = reference.nearest(&p.cast::<f32>().into());
            let (index, squared) = (nearest.index, f64::from(nearest.squared_distance));
            let across = reference.normals[index].dot(&(p - vector(&reference.points[index])));
            let along = (squared - across * across).max(0.0).sqrt() - f64::from(reference.cell);
            (across * across + along.max(0.0).powi(2)).sqrt()
        })
        .collect();
    let kept = ((distances.len() as f64 * TRIM).ceil() as usize).max(1).min(distances.len());
    distances.sort_unstable_by(f64::total_cmp);
    distances[..kept].iter().sum::<f64>() / kept.max(1) as f64
}
