//! Real pose errors on pairs the network is not trained on.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use burn::tensor::Device;
use rayon::prelude::*;
use unopose_core::{config::Config, geometry::Pose, interrupt::Interrupt};
use unopose_dataset::formats::{FormatError, ObjectSymmetries};
use unopose_eval::metrics::{EvalObject, PoseErrors, TestView};
use unopose_infer::{InferError, PairEstimate, Uniforms, estimate_pairs};
use unopose_nn::{
    loss::pair_losses,
    model::{PairTensors, UnoPose},
};
use unopose_pairs::data::{
    CloudInput, DataError, FrameSource, PairSampler, PreparedReference, TrainSample, metric_pose,
};

use super::{
    TrainError,
    journal::ValidationRecord,
    observer::{Phase, PhaseExtent, TrainObserver},
};

/// How far behind the measured surface a pixel still counts as visible in VSD, metres (BOP's value).
const VSD_DELTA: f64 = 0.015;

/// The fixed validation pairs of a run: the first of the sampler's stream, without augmentation.
pub struct Validation {
    sampler: PairSampler,
    source: Arc<dyn FrameSource>,
    /// Meshes by object; with all of them there is an average recall.
    objects: BTreeMap<u32, EvalObject>,
    truths: Vec<Truth>,
    /// Object of each pair.
    obj_ids: Vec<u32>,
    /// Objects of which only the print tells how they are turned.
    print_decided: BTreeSet<u32>,
}

/// What is known about a validation pair.
pub struct Truth {
    /// Query object to query camera, metres.
    pub t_query_object: Pose,
    /// Transforms that map the object onto itself.
    pub symmetries: ObjectSymmetries,
}

/// Errors of one pose, up to the object's symmetries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Angle between the rotations, degrees.
    pub rotation_deg: f64,
    /// Distance between the translations, metres.
    pub translation_m: f64,
}

impl Truth {
    /// The query object's pose that an estimated reference-to-query pose amounts to.
    pub fn implied(&self, t_query_reference: &Pose, estimate: &Pose) -> Pose {
        *estimate * t_query_reference.inverse() * self.t_query_object
    }
}

impl PoseError {
    /// Of an object pose.
    pub fn new(truth: &Truth, t_query_object: &Pose) -> Self {
        Self {
            rotation_deg: truth.symmetries.rotation_distance_deg(&truth.t_query_object, t_query_object),
            translation_m: truth.t_query_object.translation_distance(t_query_object),
        }
    }

    fn within(&self, degrees: f64, metres: f64) -> bool {
        self.rotation_deg <= degrees && self.translation_m <= metres
    }
}

impl Validation {
    /// The first `pairs` pairs of `sampler`, which draws from `source`. `objects` gives the meshes of the object ids
    /// it is asked for, as far as they exist.
    pub fn new(
        sampler: PairSampler,
        source: Arc<dyn FrameSource>,
        pairs: usize,
        objects: impl FnOnce(BTreeSet<u32>) -> Result<BTreeMap<u32, EvalObject>, TrainError>,
    ) -> Result<Self, TrainError> {
        let truth = |index| -> Result<(u32, Truth), TrainError> {
            let key = sampler.sample(index, false)?.key;
            let frame = source.load(key.query_image)?;
            let instance = frame.instances.get(key.query_instance as usize);
            let absent =
                || DataError::MissingInstance { image: key.query_image, instance: key.query_instance };
            let t_query_object = instance.ok_or_else(absent)?.t_camera_object;
            Ok((key.obj_id, Truth { t_query_object, symmetries: source.symmetries(key.obj_id).clone() }))
        };
        let truths: Vec<(u32, Truth)> =
            (0..pairs as u64).into_par_iter().map(truth).collect::<Result<_, _>>()?;
        let objects = objects(truths.iter().map(|(obj_id, _)| *obj_id).collect())?;
        let (obj_ids, truths): (Vec<u32>, Vec<Truth>) = truths.into_iter().unzip();
        Ok(Self { sampler, source, objects, truths, obj_ids, print_decided: BTreeSet::new() })
    }

    /// Reports the pairs of these objects, whose pose only the print tells, apart.
    pub fn with_print_decided(self, print_decided: BTreeSet<u32>) -> Self {
        Self { print_decided, ..self }
    }

    /// Losses and poses of `model` (without autodiff) on all pairs; `None` when interrupted before the last.
    pub fn run(
        &self,
        model: &UnoPose,
        config: &Config,
        device: &Device,
        observer: &dyn TrainObserver,
        interrupt: &Interrupt,
    ) -> Result<Option<ValidationRecord>, TrainError> {
        observer.begin(Phase::Validation, PhaseExtent::new(0, self.truths.len() as u64));
        let (mut final_errors, mut coarse_errors) = (Vec::new(), Vec::new());
        let (mut loss, mut recalls) = (0.0, Vec::new());
        for (batch_index, truths) in self.truths.chunks(config.train.batch_size).enumerate() {
            if interrupt.is_requested() {
                observer.end(Phase::Validation);
                return Ok(None);
            }
            let first = batch_index * config.train.batch_size;
            let samples = self.samples(first..first + truths.len())?;
            let batch = PairTensors::from_samples(&samples, &config.model, device);
            let groups = PairTensors::groups_of(&samples, &config.model, device);
            let losses = pair_losses(&config.loss, &model.forward_train(&batch, &groups), &batch);
            loss += f64::from(losses.total.into_scalar::<f32>()) * samples.len() as f64;
            let estimates = estimate(model, config, &samples, first as u64, device)?;
            let poses = |of: fn(&PairEstimate) -> Pose| -> Vec<Pose> {
                let of_pair = |((truth, sample), estimate): ((&Truth, &TrainSample), &PairEstimate)| {
                    truth.implied(&true_pose(sample), &of(estimate))
                };
                truths.iter().zip(&samples).zip(&estimates).map(of_pair).collect()
            };
            let (final_poses, coarse_poses) =
                (poses(|e| e.t_query_reference), poses(|e| e.t_query_reference_coarse));
            final_errors.extend(truths.iter().zip(&final_poses).map(|(truth, t)| PoseError::new(truth, t)));
            coarse_errors.extend(truths.iter().zip(&coarse_poses).map(|(truth, t)| PoseError::new(truth, t)));
            let recall =
                |((truth, sample), t): ((&Truth, &TrainSample), &Pose)| self.recall(truth, sample, t);
            recalls.par_extend(truths.par_iter().zip(&samples).zip(&final_poses).map(recall));
            observer.advance(Phase::Validation, (first + truths.len()) as u64, "");
        }
        observer.end(Phase::Validation);
        let recalls: Vec<Option<f64>> = recalls.into_iter().collect::<Result<_, _>>()?;
        let recalls: Vec<f64> = recalls.into_iter().collect::<Option<_>>().unwrap_or_default();
        let mut record = summary(&final_errors, &coarse_errors, loss);
        let by_print =
            final_errors.iter().zip(&self.obj_ids).filter(|(_, id)| self.print_decided.contains(id));
        let by_print: Vec<bool> = by_print.map(|(error, _)| error.rotation_deg <= 15.0).collect();
        let right = by_print.iter().filter(|right| **right).count();
        record.print_within_15deg = (!by_print.is_empty()).then(|| right as f64 / by_print.len() as f64);
        record.average_recall =
            (!recalls.is_empty()).then(|| recalls.iter().sum::<f64>() / recalls.len() as f64);
        Ok(Some(record))
    }

    /// Mean of the VSD, MSSD and MSPD recalls of one estimate; `None` without the object's mesh.
    fn recall(&self, truth: &Truth, sample: &TrainSample, t: &Pose) -> Result<Option<f64>, FormatError> {
        let Some(object) = self.objects.get(&sample.key.obj_id) else { return Ok(None) };
        let frame = self.source.load(sample.key.query_image)?.frame;
        let view = TestView { depth: &frame.depth, camera: &frame.intrinsics, delta: VSD_DELTA };
        let rendered = view.render(object, &truth.t_query_object);
        let errors = PoseErrors::new(object, &view, t, &truth.t_query_object, &rendered);
        Ok(Some(errors.average_recall(object.diameter, frame.width())))
    }

    /// Where the pairs' images are.
    pub fn source(&self) -> &dyn FrameSource {
        &*self.source
    }

    /// Prepared pairs by index.
    pub fn samples(&self, range: std::ops::Range<usize>) -> Result<Vec<TrainSample>, TrainError> {
        Ok(range.into_par_iter().map(|i| self.sampler.sample(i as u64, false)).collect::<Result<_, _>>()?)
    }

    /// What is known about each pair, in order.
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
) -> Result<Vec<PairEstimate>, InferError> {
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
        let error = PoseError::new(&plain, &plain.implied(&truth, &estimate));
        assert!((error.rotation_deg - 10.0).abs() < 1e-9 && (error.translation_m - 0.02).abs() < 1e-12);
        let axis = unopose_dataset::formats::SymmetryAxis { axis: Vector3::z(), offset: Vector3::zeros() };
        let symmetries = ObjectSymmetries { discrete: vec![], continuous: vec![axis] };
        let round = Truth { t_query_object, symmetries };
        assert!(PoseError::new(&round, &round.implied(&truth, &estimate)).rotation_deg < 1e-6);
    }

    #[test]
    fn shares_and_medians() {
        let of = |rotation_deg, translation_m| PoseError { rotation_deg, translation_m };
        let errors = [of(1.0, 0.01), of(4.0, 0.06), of(14.0, 0.3), of(170.0, 0.02)];
        let record = summary(&errors, &errors[1..3], 10.0);
        assert_eq!(
            (record.within_5deg_5cm, record.within_15deg, record.coarse_within_15deg),
            (0.25, 0.75, 0.5)
        );
        assert_eq!((record.median_rotation_deg, record.loss, record.pairs), (9.0, 2.5, 4));
        assert!((record.median_translation_m - 0.04).abs() < 1e-12);
    }
}
