//! The features of oriented point pairs and the table that finds pairs by them.

use std::f64::consts::PI;

use nalgebra::{Rotation3, UnitVector3, Vector3};
use unopose_core::geometry::Pose;

use super::super::surface::{Surface, vector};

/// Oriented points, each with the motion that puts it into the origin and its normal along x.
pub struct AlignedPoints {
    pub points: Vec<Vector3<f64>>,
    pub normals: Vec<Vector3<f64>>,
    pub to_origin: Vec<Pose>,
}

impl AlignedPoints {
    pub fn new(surface: &Surface) -> Self {
        let points: Vec<Vector3<f64>> = surface.points.iter().map(vector).collect();
        let to_origin = points
            .iter()
            .zip(&surface.normals)
            .map(|(p, n)| {
                // A half turn about any perpendicular when the normal points along -x.
                let rotation = Rotation3::rotation_between(n, &Vector3::x()).unwrap_or_else(|| {
                    Rotation3::from_axis_angle(&UnitVector3::new_unchecked(Vector3::y()), PI)
                });
                Pose::new(*rotation.matrix(), -(rotation * p))
            })
            .collect();
        Self { points, normals: surface.normals.clone(), to_origin }
    }

    /// Angle about the normal of point `i`, in (-pi, pi], at which point `j` lies once `i` is in the origin.
    pub fn angle(&self, i: usize, j: usize) -> f64 {
        let to = &self.to_origin[i];
        let p = to.rotation * self.points[j] + to.translation;
        p.z.atan2(p.y)
    }
}

/// Steps of the four numbers of a feature.
#[derive(Clone, Copy, Debug)]
struct Steps {
    distance: f64,
    angle: f64,
    distances: usize,
    angles: usize,
}

impl Steps {
    /// Number of the bucket of F = (|d|, angle(n1, d), angle(n2, d), angle(n1, n2)); `None` beyond the longest distance.
    fn bucket(&self, points: &AlignedPoints, i: usize, j: usize) -> Option<usize> {
        let line = points.points[j] - points.points[i];
        let length = line.norm();
        let distance = (length / self.distance) as usize;
        if distance >= self.distances || length <= 0.0 {
            return None;
        }
        let direction = line / length;
        let (n1, n2) = (points.normals[i], points.normals[j]);
        let step =
            |cosine: f64| ((cosine.clamp(-1.0, 1.0).acos() / self.angle) as usize).min(self.angles - 1);
        let [a, b, c] = [n1.dot(&direction), n2.dot(&direction), n1.dot(&n2)].map(step);
        Some(((distance * self.angles + a) * self.angles + b) * self.angles + c)
    }
}

/// A pair of model points: the first, and the angle of the second about the first one's normal.
#[derive(Clone, Copy, Debug)]
pub struct ModelPair {
    pub first: u32,
    pub angle: f32,
}

/// All pairs of model points by their feature.
pub struct PairTable {
    steps: Steps,
    /// Pairs of bucket `b` are `pairs[starts[b]..starts[b + 1]]`.
    starts: Vec<u32>,
    pairs: Vec<ModelPair>,
}

impl PairTable {
    /// `angles` is the number of angle steps of the full circle; the normals' angles span half of it.
    pub fn new(model: &AlignedPoints, distance_step: f64, angles: usize) -> Self {
        let count = model.points.len();
        let pairs = || (0..count).flat_map(|i| (0..count).filter(move |&j| j != i).map(move |j| (i, j)));
        let longest = pairs()
            .map(|(i, j)| (model.points[i] - model.points[j]).norm_squared())
            .fold(0.0, f64::max)
            .sqrt();
        let steps = Steps {
            distance: distance_step,
            angle: 2.0 * PI / angles as f64,
            distances: (longest / distance_step) as usize + 1,
            angles: angles.div_ceil(2).max(1),
        };
        let mut keyed: Vec<(u32, ModelPair)> = pairs()
            .filter_map(|(i, j)| {
                let pair = ModelPair { first: i as u32, angle: model.angle(i, j) as f32 };
                Some((steps.bucket(model, i, j)? as u32, pair))
            })
            .collect();
        keyed.sort_by_key(|&(bucket, _)| bucket);
        let mut starts = vec![0u32; steps.distances * steps.angles.pow(3) + 1];
        keyed.iter().for_each(|&(bucket, _)| starts[bucket as usize + 1] += 1);
        let mut sum = 0;
        for start in &mut starts {
            sum += *start;
            *start = sum;
        }
        Self { steps, starts, pairs: keyed.into_iter().map(|(_, pair)| pair).collect() }
    }

    /// Model pairs with the feature of two points.
    pub fn similar(&self, points: &AlignedPoints, i: usize, j: usize) -> &[ModelPair] {
        match self.steps.bucket(points, i, j) {
            Some(bucket) => &self.pairs[self.starts[bucket] as usize..self.starts[bucket + 1] as usize],
            None => &[],
        }
    }

    /// Width of a step of the voted angle, radians.
    pub fn angle_step(&self) -> f64 {
        self.steps.angle
    }
}
