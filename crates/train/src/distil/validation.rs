//! How well features tell the points of an object apart.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::config::Config;
use unopose_eval::eval::roc_area;
use unopose_nn::model::Student;

use super::views::PairViews;
use crate::{
    TrainError,
    journal::ValidationRecord,
    observer::{Phase, PhaseExtent},
    options::TrainOptions,
};

/// Points of another place are at least this many match distances away.
const CLEARLY_OTHER: f32 = 2.0;

/// Validation pairs in batches, with the teacher's features.
pub struct FeatureValidation {
    batches: Vec<PairViews>,
}

/// How features are compared.
#[derive(Clone, Copy)]
pub enum Comparison {
    /// The cosine of their angle.
    Cosine,
    /// Minus their distance.
    Distance,
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
            areas.extend(pair_areas(&features, &views.distances, config, Comparison::Cosine));
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
            colors.extend(pair_areas(&raw, &views.distances, config, Comparison::Distance));
            teacher.extend(pair_areas(&views.teacher, &views.distances, config, Comparison::Cosine));
        }
        [mean(&colors), mean(&teacher)]
    }

    /// The pairs that pictures show.
    pub fn shown(&self) -> Option<&PairViews> {
        self.batches.first()
    }
}

/// Area under the ROC curve of each pair that has right and wrong matches: every query point's nearest reference point, where
/// they match, against the clearly other reference points.
fn pair_areas(
    features: &[Tensor<3>; 2],
    distances: &Tensor<3>,
    config: &Config,
    comparison: Comparison,
) -> Vec<f64> {
    let [batch, queries, references] = distances.dims();
    let channels = features[0].dims()[2];
    let host = |tensor: &Tensor<3>| -> Vec<f32> { tensor.clone().into_data().iter::<f32>().collect() };
    let ([query, reference], distances) = (features.each_ref().map(host), host(distances));
    let near = config.loss.overlap_distance;
    let of_pair = |pair: usize| {
        let row = |values: &'_ [f32], index: usize| values[index * channels..(index + 1) * channels].to_vec();
        let references_of: Vec<Vec<f32>> =
            (0..references).map(|j| row(&reference, pair * references + j)).collect();
        let mut scored = Vec::new();
        for i in 0..queries {
            let own = row(&query, pair * queries + i);
            let to = &distances[(pair * queries + i) * references..][..references];
            let Some(nearest) = (0..references).min_by(|&a, &b| to[a].total_cmp(&to[b])) else { continue };
            if to[nearest] > near {
                continue;
            }
            let wrong = (0..references).filter(|&j| to[j] >= CLEARLY_OTHER * near).map(|j| (j, false));
            let all = wrong.chain([(nearest, true)]);
            scored.extend(all.map(|(j, right)| (similarity(&own, &references_of[j], comparison), right)));
        }
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        roc_area(&scored)
    };
    (0..batch).into_par_iter().filter_map(of_pair).collect()
}

fn similarity(a: &[f32], b: &[f32], comparison: Comparison) -> f64 {
    let sum = |of: fn(f64, f64) -> f64| a.iter().zip(b).map(|(&a, &b)| of(a.into(), b.into())).sum::<f64>();
    match comparison {
        Comparison::Distance => -sum(|a, b| (a - b).powi(2)).sqrt(),
        Comparison::Cosine => {
            let lengths = sum(|a, _| a * a).sqrt() * sum(|_, b| b * b).sqrt();
            sum(|a, b| a * b) / lengths.max(1e-12)
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn areas_count_nearest_points_against_clearly_other_ones() {
        let device = Device::default();
        let rows = |values: [[f32; 2]; 3]| Tensor::<2>::from_floats(values, &device).unsqueeze::<3>();
        let config = Config::default();
        // Matches 0-0 and 1-1; query 2 has none; 0-1 is too near to be wrong (0.15 and twice that).
        let distances =
            Tensor::<2>::from_floats([[0.1, 0.2, 0.9], [0.5, 0.15, 0.9], [0.4, 0.4, 0.4]], &device);
        let features =
            [rows([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]), rows([[1.0, 0.1], [0.1, 1.0], [2.0, 1.0]])];
        let areas = pair_areas(&features, &distances.unsqueeze(), &config, Comparison::Cosine);
        // Right: 0.995, 0.995. Wrong: 0-2 0.894; 1-0 0.0995; 1-2 0.447.
        assert_eq!(areas, [1.0]);
        // By distance: right 0.1, 0.1; wrong 0-2 sqrt 2; 1-0 1.345; 1-2 2. With the references of 0 and 2 exchanged:
        let swapped = [features[0].clone(), rows([[2.0, 1.0], [0.1, 1.0], [1.0, 0.1]])];
        let distances =
            Tensor::<2>::from_floats([[0.1, 0.2, 0.9], [0.5, 0.15, 0.9], [0.4, 0.4, 0.4]], &device);
        let areas = pair_areas(&swapped, &distances.unsqueeze(), &config, Comparison::Distance);
        // Right: 0-0 1.414, 1-1 0.1. Wrong: 0-2 0.1, 1-0 2.0, 1-2 1.345. Wins: 0-0 beats one, 1-1 two and half.
        assert_eq!(areas.len(), 1);
        assert!((areas[0] - 3.5 / 6.0).abs() < 1e-9, "{areas:?}");
    }
}
