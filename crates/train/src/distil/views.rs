//! A batch of pairs as teacher and student see it.

use burn::tensor::{Device, Tensor};
use unopose_core::config::{Config, ModelConfig};
use unopose_nn::{
    loss::{FeaturePair, Losses, MatchLabels, distil_losses},
    model::{PairTensors, Student, ViewTensors},
};
use unopose_pairs::data::TrainSample;

use super::teacher::Teacher;

/// The first `distil.points` points of query and reference, with the teacher's features and the student's crops. Constants.
pub struct PairViews {
    /// What the student sees, query and reference.
    pub views: [ViewTensors; 2],
    /// The teacher's features `[B, P, C]`.
    pub teacher: [Tensor<3>; 2],
    /// Distances between the points under the true pose `[B, P, P]`, radii.
    pub distances: Tensor<3>,
}

impl PairViews {
    /// Of samples that were prepared with [`Teacher::preparation`].
    pub fn new(
        samples: &[TrainSample],
        teacher: &Teacher,
        preparation: &ModelConfig,
        config: &Config,
        device: &Device,
    ) -> Self {
        let batch = PairTensors::from_samples(samples, preparation, device);
        let count = config.distil.points;
        let large = [&batch.query.view, &batch.reference.view]
            .map(|view| ViewTensors { images: view.images.clone(), choose: view.choose.first(count) });
        let [query, reference] = batch.points.map(|points| points.narrow(1, 0, count));
        let loss = &config.loss;
        let labels =
            MatchLabels::new(query, reference, &batch.pose, loss.match_distance, loss.overlap_distance);
        Self {
            teacher: large.each_ref().map(|view| teacher.features(view.images.clone(), &view.choose)),
            views: large.each_ref().map(|view| teacher.reduced(view, &config.model)),
            distances: labels.distances,
        }
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.distances.dims()[0]
    }

    /// The pairs `first..first + count`.
    pub fn part(&self, first: usize, count: usize) -> Self {
        let of = |view: &ViewTensors| ViewTensors {
            images: view.images.clone().narrow(0, first, count),
            choose: view.choose.items(first, count),
        };
        Self {
            views: self.views.each_ref().map(of),
            teacher: self.teacher.clone().map(|features| features.narrow(0, first, count)),
            distances: self.distances.clone().narrow(0, first, count),
        }
    }

    /// The student's features `[B, P, C_color]` of query and reference, computed as one batch.
    pub fn features(&self, student: &Student) -> [Tensor<3>; 2] {
        let [query, reference] = &self.views;
        let images = Tensor::cat(vec![query.images.clone(), reference.images.clone()], 0);
        let features = student.features(images, &query.choose.chain(&reference.choose));
        let count = self.len();
        [features.clone().narrow(0, 0, count), features.narrow(0, count, count)]
    }

    /// Losses of the student's features; the constants join the tape of `features`.
    pub fn losses(&self, student: &Student, features: [Tensor<3>; 2], config: &Config) -> Losses {
        let like = |constant: &Tensor<3>| match features[0].device().is_autodiff() {
            true => constant.clone().autodiff(),
            false => constant.clone(),
        };
        let pairs = FeaturePair {
            mapped: features.clone().map(|features| student.head.forward(features)),
            teacher: self.teacher.each_ref().map(like),
            features: features.clone(),
        };
        // What nearest neighbours are is the overlap's distance; `match_distance` is far wider.
        distil_losses(&config.distil, &pairs, &like(&self.distances), config.loss.overlap_distance)
    }
}
