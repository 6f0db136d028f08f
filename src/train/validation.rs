//! Real pose errors on pairs the network is not trained on.

use std::sync::Arc;

use burn::tensor::Device;
use rayon::prelude::*;

use super::{TrainError, journal::ValidationRecord, progress::Progress};
use crate::{
    config::Config,
    data::{CloudInput, PairSampler, PreparedReference, TrainSample, metric_pose},
    formats::{ObjectSymmetries, megapose::ShardDataset},
    geometry::Pose,
    infer::{PairEstimate, Uniforms, estimate_pairs},
    loss::pair_losses,
    model::{PairTensors, UnoPose},
};

/// The fixed validation pairs of a run: the first of the sampler's stream, without augmentation.
pub struct Validation {
    sampler: Arc<PairSampler>,
    truths: Vec<Truth>,
}

/// What is known about a validation pair.
pub struct Truth {
    /// Query object to query camera, metres.
    pub t_query_object: Pose,
    pub symmetries: ObjectSymmetries,
}

/// Errors of one pose, up to the object's symmetries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    pub rotation_deg: f64,
    pub translation_m: f64,
}

impl PoseError {
    /// Of an estimated reference-to-query pose: the query object's pose it implies against the true one.
    pub fn new(truth: &Truth, t_query_reference: &Pose, estimate: &Pose) -> Self {
        let implied = *estimate * t_query_reference.inverse() * truth.t_query_object;
        Self {
            rotation_deg: truth.symmetries.rotation_distance_deg(&truth.t_query_object, &implied),
            translation_m: truth.t_query_object.translation_distance(&implied),
        }
    }

    fn within(&self, degrees: f64, metres: f64) -> bool {
        self.rotation_deg <= degrees && self.translation_m <= metres
    }
}

impl Validation {
    pub fn new(sampler: Arc<PairSampler>, dataset: &ShardDataset, pairs: usize) -> Result<Self, TrainError> {
        let truths = (0..pairs as u64)
            .into_par_iter()
            .map(|index| {
                let sample = sampler.sample(index, false)?;
                let (image, instance) = (sample.key.query_image, sample.key.query_instance);
                let frame = dataset.load(image)?;
                let instance = frame.instances.get(instance as usize).ok_or_else(|| {
                    TrainError::Unusable(format!("validation image {image} has no instance {instance}"))
                })?;
                Ok(Truth {
                    t_query_object: instance.t_camera_object,
                    symmetries: dataset.symmetries(instance.obj_id).clone(),
                })
            })
            .collect::<Result<_, TrainError>>()?;
        Ok(Self { sampler, truths })
    }

    /// Losses and poses of `model` (without autodiff) on all pairs.
    pub fn run(&self, model: &UnoPose, config: &Config, device: &Device) -> Result<ValidationRecord, TrainError> {
        let mut progress = Progress::new("validating", 0, self.truths.len() as u64);
        let (mut final_errors, mut coarse_errors) = (Vec::new(), Vec::new());
        let mut loss = 0.0;
        for (batch_index, truths) in self.truths.chunks(config.train.batch_size).enumerate() {
            let first = batch_index * config.train.batch_size;
            let samples = self.samples(first..first + truths.len())?;
            let batch = PairTensors::from_samples(&samples, &config.model, device);
            let losses = pair_losses(&config.loss, &model.forward_train(&batch), &batch);
            loss += f64::from(losses.total.into_scalar::<f32>()) * samples.len() as f64;
            let estimates = estimate(model, config, &samples, first as u64, device);
            for ((truth, sample), estimate) in truths.iter().zip(&samples).zip(&estimates) {
                let t = true_pose(sample);
                final_errors.push(PoseError::new(truth, &t, &estimate.t_query_reference));
                coarse_errors.push(PoseError::new(truth, &t, &estimate.t_query_reference_coarse));
            }
            progress.set((first + truths.len()) as u64, "");
        }
        progress.finish();
        Ok(summary(&final_errors, &coarse_errors, loss))
    }

    /// Prepared pairs by index.
    pub fn samples(&self, range: std::ops::Range<usize>) -> Result<Vec<TrainSample>, TrainError> {
        Ok(range.into_par_iter().map(|i| self.sampler.sample(i as u64, false)).collect::<Result<_, _>>()?)
    }

    pub fn truths(&self) -> &[Truth] {
        &self.truths
    }
}

/// Poses of prepared samples.
pub fn estimate(
    model: &UnoPose,
    config: &Config,
    samples: &[TrainSample],
    first: u64,
    device: &Device,
) -> Vec<PairEstimate> {
    let pairs: Vec<(&CloudInput, &PreparedReference)> =
        samples.iter().map(|s| (&s.query, &s.reference)).collect();
    estimate_pairs(model, &config.model, &pairs, Uniforms::Seed(config.seed.wrapping_add(first)), device)
}

/// The label of a sample in metres.
pub fn true_pose(sample: &TrainSample) -> Pose {
    let reference = &sample.reference;
    metric_pose(&sample.t_query_reference, sample.query.center, reference.cloud.center, reference.radius)
}

fn summary(errors: &[PoseError], coarse: &[PoseError], loss_sum: f64) -> ValidationRecord {
    let count = errors.len().max(1) as f64;
    let share = |errors: &[PoseError], degrees, metres| {
        errors.iter().filter(|e| e.within(degrees, metres)).count() as f64 / count
    };
    ValidationRecord {
        pairs: errors.len(),
        loss: loss_sum / count,
        median_rotation_deg: median(errors.iter().map(|e| e.rotation_deg)),
        median_translation_m: median(errors.iter().map(|e| e.translation_m)),
        within_5deg_5cm: share(errors, 5.0, 0.05),
        within_15deg: share(errors, 15.0, f64::INFINITY),
        coarse_within_15deg: share(coarse, 15.0, f64::INFINITY),
        ..ValidationRecord::default()
    }
}

/// Middle value, the mean of the two middle ones for an even count, 0 for none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    match values.as_slice() {
        [] => 0.0,
        v if v.len() % 2 == 1 => v[v.len() / 2],
        v => (v[v.len() / 2 - 1] + v[v.len() / 2]) / 2.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    fn turn(axis: Vector3<f64>, degrees: f64, translation: Vector3<f64>) -> Pose {
        Pose::new(*Rotation3::new(axis.normalize() * degrees.to_radians()).matrix(), translation)
    }

    #[test]
    fn errors_are_of_the_object_and_know_its_symmetries() {
        let t_query_object = turn(Vector3::new(1.0, 2.0, 0.5), 40.0, Vector3::new(0.1, 0.0, 0.8));
        let t_reference_object = turn(Vector3::new(0.0, 1.0, 0.3), -70.0, Vector3::new(0.0, 0.1, 0.5));
        let truth = t_query_object * t_reference_object.inverse();
        // Off by 10 degrees about the object's own z axis and 2 cm.
        let slip = turn(Vector3::z(), 10.0, Vector3::zeros());
        let shift = Pose::new(nalgebra::Matrix3::identity(), Vector3::new(0.0, 0.02, 0.0));
        let estimate = shift * t_query_object * slip * t_reference_object.inverse();
        let plain = Truth { t_query_object, symmetries: ObjectSymmetries::default() };
        let error = PoseError::new(&plain, &truth, &estimate);
        assert!((error.rotation_deg - 10.0).abs() < 1e-9 && (error.translation_m - 0.02).abs() < 1e-12);
        let axis = crate::formats::SymmetryAxis { axis: Vector3::z(), offset: Vector3::zeros() };
        let symmetries = ObjectSymmetries { discrete: vec![], continuous: vec![axis] };
        let round = Truth { t_query_object, symmetries };
        assert!(PoseError::new(&round, &truth, &estimate).rotation_deg < 1e-6);
    }

    #[test]
    fn shares_and_medians() {
        let of = |rotation_deg, translation_m| PoseError { rotation_deg, translation_m };
        let errors = [of(1.0, 0.01), of(4.0, 0.06), of(14.0, 0.3), of(170.0, 0.02)];
        let record = summary(&errors, &errors[1..3], 10.0);
        assert_eq!((record.within_5deg_5cm, record.within_15deg, record.coarse_within_15deg), (0.25, 0.75, 0.5));
        assert_eq!((record.median_rotation_deg, record.loss, record.pairs), (9.0, 2.5, 4));
        assert!((record.median_translation_m - 0.04).abs() < 1e-12);
    }
}
