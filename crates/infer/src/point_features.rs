//! The colour encoder's features as evidence for a pose: points that it brings together must look alike.

use burn::tensor::Tensor;
use unopose_core::geometry::Pose;

use super::InferError;

/// Points of the reference that are compared, the first, which are spread over its surface.
const COMPARED: usize = 192;
/// Largest distance of a moved reference point from the query point that it is compared with, radii.
const NEAR: f32 = 0.12;
/// A pose that brings few points together is judged as if this many more had nothing in common.
const UNKNOWN: f64 = 16.0;

/// Features of a cloud's dense points.
#[derive(Clone, Debug, Default)]
pub(super) struct PointFeatures {
    /// Row by row.
    rows: Vec<f32>,
    channels: usize,
}

impl PointFeatures {
    /// Of every item of a batch `[B, N, C]`, read from the device.
    pub fn of_batch(features: &Tensor<3>) -> Result<Vec<Self>, InferError> {
        let [batch, points, channels] = features.dims();
        let values = features.clone().try_into_data().map_err(InferError::readback("colour features"))?;
        let rows: Vec<f32> = values.iter::<f32>().collect();
        let of = |item: usize| rows[item * points * channels..(item + 1) * points * channels].to_vec();
        Ok((0..batch).map(|item| Self { rows: of(item), channels }).collect())
    }

    fn mean(&self) -> Vec<f64> {
        let mut sum = vec![0.0; self.channels];
        for row in self.rows.chunks_exact(self.channels.max(1)) {
            sum.iter_mut().zip(row).for_each(|(sum, &value)| *sum += f64::from(value));
        }
        let count = (self.rows.len() / self.channels.max(1)).max(1) as f64;
        sum.iter_mut().for_each(|sum| *sum /= count);
        sum
    }

    /// Differences from `mean`, of unit length.
    fn directions(&self, mean: &[f64], count: usize) -> Vec<f32> {
        let rows = self.rows.chunks_exact(self.channels.max(1)).take(count);
        let direction = |row: &[f32]| {
            let difference: Vec<f64> =
                row.iter().zip(mean).map(|(&value, mean)| f64::from(value) - mean).collect();
            let length = difference.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
            difference.into_iter().map(move |x| (x / length) as f32)
        };
        rows.flat_map(direction).collect()
    }
}

/// The features of both clouds of a pair.
#[derive(Debug)]
pub(super) struct FeatureAgreement<'a> {
    points: [&'a [[f32; 3]]; 2],
    directions: [Vec<f32>; 2],
    channels: usize,
}

impl<'a> FeatureAgreement<'a> {
    /// Of the dense points of query and reference in the matching frames, radii, and their features. `None` when they are not of
    /// one kind.
    pub fn new(points: [&'a [[f32; 3]]; 2], features: [&PointFeatures; 2]) -> Option<Self> {
        let channels = features[0].channels;
        let whole = points.iter().zip(features).all(|(p, f)| p.len() * channels == f.rows.len());
        if channels == 0 || features[1].channels != channels || !whole {
            return None;
        }
        // What all points of the object have in common says nothing about their places.
        let means = features.map(PointFeatures::mean);
        let mean: Vec<f64> = means[0].iter().zip(&means[1]).map(|(a, b)| (a + b) / 2.0).collect();
        let directions = [features[0].directions(&mean, usize::MAX), features[1].directions(&mean, COMPARED)];
        Some(Self { points, directions, channels })
    }

    /// Mean cosine between the features of reference points, moved by `t_query_reference`, and of the query points that they come
    /// to lie on, in [-1, 1]; 0 when they meet none.
    pub fn of(&self, t_query_reference: &Pose) -> f64 {
        let [query, reference] = self.points;
        let (mut sum, mut count) = (0.0, 0.0);
        for (point, own) in reference.iter().zip(self.directions[1].chunks_exact(self.channels)) {
            let moved = t_query_reference.transform_f32(point);
            let squared = |p: &[f32; 3]| (0..3).map(|i| (p[i] - moved[i]).powi(2)).sum::<f32>();
            let mut nearest = (NEAR * NEAR, None);
            for (index, p) in query.iter().enumerate() {
                let distance = squared(p);
                if distance < nearest.0 {
                    nearest = (distance, Some(index));
                }
            }
            let Some(index) = nearest.1 else { continue };
            let other = &self.directions[0][index * self.channels..(index + 1) * self.channels];
            sum += own.iter().zip(other).map(|(a, b)| f64::from(a * b)).sum::<f64>();
            count += 1.0;
        }
        sum / (count + UNKNOWN)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, Vector3};

    use super::*;

    /// A ring of points whose features change around it.
    fn ring(turn: f64) -> (Vec<[f32; 3]>, PointFeatures) {
        let angles: Vec<f64> = (0..120).map(|i| f64::from(i) * 3f64.to_radians()).collect();
        let points = angles.iter().map(|a| [a.cos() as f32, a.sin() as f32, 0.0]).collect();
        let row = |a: &f64| [(a + turn).cos() as f32 + 5.0, (a + turn).sin() as f32, 2.0];
        (points, PointFeatures { rows: angles.iter().flat_map(row).collect(), channels: 3 })
    }

    #[test]
    fn the_turn_that_brings_like_features_together_agrees_most() {
        let (query_points, query) = ring(60f64.to_radians());
        let (reference_points, reference) = ring(0.0);
        let agreement =
            FeatureAgreement::new([&query_points, &reference_points], [&query, &reference]).unwrap();
        let turned = |degrees: f64| {
            let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
            agreement.of(&Pose::new(*rotation.matrix(), Vector3::zeros()))
        };
        // What is at angle a of the reference is at a - 60 degrees of the query.
        let all = 120.0 / (120.0 + UNKNOWN);
        assert!((turned(-60.0) - all).abs() < 1e-3, "{}", turned(-60.0));
        assert!((turned(120.0) + all).abs() < 1e-3, "{}", turned(120.0));
        assert!((turned(30.0)).abs() < 1e-3, "{}", turned(30.0));
        let away = Pose::new(Matrix3::identity(), Vector3::new(0.0, 0.0, 1.0));
        assert_eq!(agreement.of(&away), 0.0);
        let fewer = PointFeatures { rows: vec![0.0; 6], channels: 3 };
        assert!(FeatureAgreement::new([&query_points, &reference_points], [&fewer, &reference]).is_none());
    }
}
