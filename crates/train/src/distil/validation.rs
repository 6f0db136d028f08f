//! How well features tell the points of an object apart.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::config::Config;
use unopose_eval::metrics::{FeatureSimilarity, match_area};
use unopose_nn::model::Student;

use super::views::PairViews;
use crate::{
    TrainError,
    journal::ValidationRecord,
    observer::{Phase, PhaseExtent},
    options::TrainOptions,
};

/// Validation pairs in batches, with the teacher's features.
pub struct FeatureValidation {
    batches: Vec<PairViews>,
}

impl FeatureValidation {
    /// Of these pairs.
    pub fn new(batches: Vec<PairViews>) -> Self {
        Self { batches }
    }

    /// Losses and ROC area of a student without autodiff; `None` when interrupted.
    pub fn run(
        &self,
        student: &Student,
        config: &Config,
        options: &TrainOptions,
    ) -> Result<Option<ValidationRecord>, TrainError> {
        let total = self.batches.iter().map(|b| b.len() as u64).sum();
        options.observer.begin(Phase::Validation, PhaseExtent::new(0, total));
        let (mut loss, mut areas, mut done) = (0.0, Vec::new(), 0);
        for views in &self.batches {
            if options.interrupt.is_requested() {
                options.observer.end(Phase::Validation);
                return Ok(None);
            }
            let features = views.features(student);
            areas.extend(pair_areas(&features, &views.distances, config, FeatureSimilarity::Cosine));
            let losses = views.losses(student, features, config);
            loss += f64::from(losses.total.into_scalar::<f32>()) * views.len() as f64;
            done += views.len() as u64;
            options.observer.advance(Phase::Validation, done, "");
        }
        options.observer.end(Phase::Validation);
        Ok(Some(ValidationRecord {
            pairs: done as usize,
            loss: loss / done.max(1) as f64,
            roc_area: Some(mean(&areas)),
            ..ValidationRecord::default()
        }))
    }

    /// The same area for raw colours and for the teacher.
    pub fn yardsticks(&self, config: &Config) -> [f64; 2] {
        let (mut colors, mut teacher) = (Vec::new(), Vec::new());
        for views in &self.batches {
            let raw = views.views.each_ref().map(|view| {
                let [batch, channels, side, _] = view.images.dims();
                let pixels =
                    view.images.clone().permute([0, 2, 3, 1]).reshape([batch, side * side, channels]);
                view.choose.sample_grid(pixels, side)
            });
            colors.extend(pair_areas(&raw, &views.distances, config, FeatureSimilarity::Distance));
            teacher.extend(pair_areas(&views.teacher, &views.distances, config, FeatureSimilarity::Cosine));
        }
        [mean(&colors), mean(&teacher)]
    }

    /// The pairs that pictures show.
    pub fn shown(&self) -> Option<&PairViews> {
        self.batches.first()
    }
}

/// [`match_area`] of each pair of a batch that has matches.
fn pair_areas(
    features: &[Tensor<3>; 2],
    distances: &Tensor<3>,
    config: &Config,
    similarity: FeatureSimilarity,
) -> Vec<f64> {
    let [batch, queries, references] = distances.dims();
    let channels = features[0].dims()[2];
    let host = |tensor: &Tensor<3>| -> Vec<f32> { tensor.clone().into_data().iter::<f32>().collect() };
    let ([query, reference], distances) = (features.each_ref().map(host), host(distances));
    let of_pair = |pair: usize| {
        let rows = |values: &'_ [f32], count: usize| values[pair * count..(pair + 1) * count].to_vec();
        let views = [rows(&query, queries * channels), rows(&reference, references * channels)];
        let distances = rows(&distances, queries * references);
        let near = config.loss.overlap_distance;
        match_area([&views[0], &views[1]], channels, &distances, near, similarity)
    };
    (0..batch).into_par_iter().filter_map(of_pair).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
