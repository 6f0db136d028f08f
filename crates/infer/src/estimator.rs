//! [`PoseEstimator`]: a loaded network with what surrounds it.

use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
    time::Instant,
};

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use unopose_core::{
    config::ModelConfig,
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_nn::{
    checkpoint,
    device::DeviceChoice,
    model::{EncodedCloud, UnoPose},
};
use unopose_pairs::{
    data::{CloudInput, normalised_pose, prepare_query, prepare_reference},
    registration::icp::refine_with,
};

use super::{
    Calibration, Candidate, CloudPair, Estimate, Evidence, InferError, Judge, PairTrace, Query, Reference,
    Refinement, StageTimes, Timings, Trace, Uniforms, encode_references,
    streams::{self, stream},
    trace_encoded,
};

/// Where the default checkpoint lies, beside the binary or in the working directory.
const DEFAULT_CHECKPOINT: &str = "checkpoints/geo.safetensors";

/// Largest batch of one forward pass, which bounds memory. A GPU gains from it; on the CPU only the colours of a few queries
/// are computed together.
const MAX_BATCH: usize = 8;

/// Estimates poses of instances against reference views.
#[derive(Debug)]
pub struct PoseEstimator {
    pub(super) model: UnoPose,
    pub(super) config: ModelConfig,
    pub(super) device: Device,
    pub(super) backend: DeviceChoice,
    /// Where the weights come from.
    pub(super) source: String,
    pub(super) seed: u64,
    pub(super) refinement: Refinement,
    pub(super) calibration: Option<Calibration>,
    /// Replaces the calibration's threshold.
    pub(super) min_confidence: Option<f64>,
    /// See [`PoseEstimator::network`].
    pub(super) network: OnceLock<String>,
}

impl PoseEstimator {
    /// The network of a checkpoint, with the configuration inside it.
    pub fn load(path: &Path, device: DeviceChoice) -> Result<Self, InferError> {
        let (device, backend) = device.open()?;
        let (model, config, meta) = checkpoint::load(path, &device)?;
        let calibration = Calibration::from_metadata(&meta.extra, path)?;
        let estimator = Self::new(model, config.model, device, backend, path.display().to_string());
        Ok(Self { calibration, ..estimator })
    }

    /// The network that is compiled in; an error in builds without one.
    pub fn embedded(device: DeviceChoice) -> Result<Self, InferError> {
        let bytes = unopose_checkpoints::GEO.ok_or(InferError::NoCheckpoint { looked: Vec::new() })?;
        let (device, backend) = device.open()?;
        let name = format!("embedded {DEFAULT_CHECKPOINT}");
        let (model, config, meta) = checkpoint::load_bytes(bytes, &name, &device)?;
        let calibration = Calibration::from_metadata(&meta.extra, Path::new(&name))?;
        Ok(Self { calibration, ..Self::new(model, config.model, device, backend, name) })
    }

    /// `checkpoints/geo.safetensors` beside the binary, else in the working directory, else the embedded one.
    pub fn load_default(device: DeviceChoice) -> Result<Self, InferError> {
        let beside =
            std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(DEFAULT_CHECKPOINT)));
        let looked: Vec<PathBuf> = beside.into_iter().chain([PathBuf::from(DEFAULT_CHECKPOINT)]).collect();
        match looked.iter().find(|path| path.is_file()) {
            Some(path) => Self::load(path, device),
            None if unopose_checkpoints::GEO.is_some() => Self::embedded(device),
            None => Err(InferError::NoCheckpoint { looked }),
        }
    }

    /// From a network in memory that is not on the autodiff tape.
    pub fn from_model(model: UnoPose, config: ModelConfig, device: Device) -> Self {
        Self::new(model, config, device, DeviceChoice::Auto, "memory".into())
    }

    fn new(
        model: UnoPose,
        config: ModelConfig,
        device: Device,
        backend: DeviceChoice,
        source: String,
    ) -> Self {
        Self {
            model,
            config,
            device,
            backend,
            source,
            seed: 0,
            refinement: Refinement::None,
            calibration: None,
            min_confidence: None,
            network: OnceLock::new(),
        }
    }

    /// Checksums of the weights and of the configuration: equal for equal networks, wherever they come from.
    pub fn network(&self) -> Result<&str, InferError> {
        if let Some(network) = self.network.get() {
            return Ok(network);
        }
        let weights = checkpoint::checksum(&self.model)?;
        let config = serde_json::to_string(&self.config).unwrap_or_default();
        let network = format!("{weights:08x}-{:08x}", crc32fast::hash(config.as_bytes()));
        Ok(self.network.get_or_init(|| network))
    }

    /// Values on the estimator's device.
    pub(super) fn tensor<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
        Tensor::from_data(TensorData::new(values, shape), &self.device)
    }

    /// Prepares and encodes a reference view of an object.
    pub fn reference(&self, frame: &RgbdFrame, mask: &Mask) -> Result<Reference, InferError> {
        let start = Instant::now();
        let mut rng = stream(self.seed, streams::REFERENCE_POINTS);
        let prepared =
            prepare_reference(frame, mask, &self.config, &mut rng).map_err(InferError::Reference)?;
        let encoded = encode_references(&self.model, &self.config, &[&prepared], &self.device);
        let reference = Reference {
            cloud: prepared.cloud,
            radius: prepared.radius,
            encoded,
            points: frame.masked_points(mask),
            surface: OnceLock::new(),
            seconds: 0.0,
        };
        if self.refinement != Refinement::None {
            reference.surface();
        }
        Ok(Reference { seconds: start.elapsed().as_secs_f64(), ..reference })
    }

    /// The pose of every instance of a query view, in the order of `masks`.
    pub fn estimate(
        &self,
        reference: &Reference,
        frame: &RgbdFrame,
        masks: &[Mask],
    ) -> Vec<Result<Estimate, InferError>> {
        let queries: Vec<Query<'_>> = masks.iter().map(|mask| Query { reference, frame, mask }).collect();
        self.estimate_batch(&queries)
    }

    /// [`Self::estimate`] of instances of any views, each with its own reference. A pose does not depend on the other
    /// instances of the list.
    pub fn estimate_batch(&self, queries: &[Query<'_>]) -> Vec<Result<Estimate, InferError>> {
        let prepared: Vec<Result<(CloudInput, f64), InferError>> =
            queries.par_iter().map(|query| self.prepare(query)).collect();
        let usable: Vec<(&Query<'_>, &CloudInput, f64)> = queries
            .iter()
            .zip(&prepared)
            .filter_map(|(query, prepared)| prepared.as_ref().ok().map(|(cloud, t)| (query, cloud, *t)))
            .collect();
        let estimates: Vec<Result<Estimate, InferError>> =
            usable.chunks(MAX_BATCH).flat_map(|chunk| self.estimate_chunk(chunk)).collect();
        let mut estimates = estimates.into_iter();
        let mut next = |_| estimates.next().unwrap_or(Err(InferError::Incomplete));
        prepared.into_iter().map(|prepared| prepared.and_then(&mut next)).collect()
    }

    /// One instance with everything that led to its pose.
    pub fn trace(&self, query: &Query<'_>) -> Result<Trace, InferError> {
        let (cloud, prepare) = self.prepare(query)?;
        let (mut traces, times) = self.run(&[(query, &cloud, prepare)], None)?;
        let stages = traces.pop().ok_or(InferError::Incomplete)?;
        Ok(Trace { estimate: self.finish(query, (&cloud, prepare), &stages, times)?, stages, cloud })
    }

    /// The pose of the fine stage when it starts from `t_query_reference` (metres) instead of the coarse pose; `None`
    /// without a fine stage.
    pub fn fine_from(&self, query: &Query<'_>, t_query_reference: &Pose) -> Result<Option<Pose>, InferError> {
        let (cloud, prepare) = self.prepare(query)?;
        let pair = query.reference.pair(&cloud);
        let start = normalised_pose(t_query_reference, cloud.center, pair.reference.center, pair.radius);
        let (mut traces, _) = self.run(&[(query, &cloud, prepare)], Some(&[start]))?;
        let stages = traces.pop().filter(|stages| stages.fine().is_some());
        Ok(stages.map(|stages| stages.estimate(&pair).t_query_reference))
    }

    fn prepare(&self, query: &Query<'_>) -> Result<(CloudInput, f64), InferError> {
        let start = Instant::now();
        let mut rng = stream(self.seed, streams::QUERY_POINTS);
        let radius = query.reference.radius;
        let cloud = prepare_query(query.frame, query.mask, radius, &self.config, &mut rng);
        Ok((cloud.map_err(InferError::Query)?, start.elapsed().as_secs_f64()))
    }

    fn estimate_chunk(&self, chunk: &[(&Query<'_>, &CloudInput, f64)]) -> Vec<Result<Estimate, InferError>> {
        match self.run(chunk, None) {
            Ok((traces, times)) => {
                let share = times.divided(chunk.len());
                chunk
                    .par_iter()
                    .zip(traces)
                    .map(|((query, cloud, prepare), stages)| {
                        self.finish(query, (cloud, *prepare), &stages, share)
                    })
                    .collect()
            }
            // One failed pass fails all of its pairs.
            Err(error) => {
                let message = error.to_string();
                let failed = |_| Err(InferError::Forward { message: message.clone() });
                chunk.iter().map(failed).collect()
            }
        }
    }

    /// The network on prepared queries, as one batch.
    fn run(
        &self,
        chunk: &[(&Query<'_>, &CloudInput, f64)],
        given: Option<&[Pose]>,
    ) -> Result<(Vec<PairTrace>, StageTimes), InferError> {
        let pairs: Vec<CloudPair<'_>> =
            chunk.iter().map(|(query, cloud, _)| query.reference.pair(cloud)).collect();
        let references: Vec<&EncodedCloud> = chunk.iter().map(|(q, ..)| &q.reference.encoded).collect();
        let uniforms = Uniforms::Shared(self.seed);
        trace_encoded(&self.model, &self.config, &pairs, &references, uniforms, given, &self.device)
    }

    /// Refines the pose from every start, and lets the one win that both views speak for.
    fn finish(
        &self,
        query: &Query<'_>,
        (cloud, prepare): (&CloudInput, f64),
        stages: &PairTrace,
        network: StageTimes,
    ) -> Result<Estimate, InferError> {
        let start = Instant::now();
        let clouds = query.reference.pair(cloud);
        let surface = self.refinement.settings().zip(query.reference.surface());
        let points = surface.map(|_| query.frame.masked_points(query.mask)).unwrap_or_default();
        let refined = |pose: &Pose| match &surface {
            Some((settings, surface)) => refine_with(&points, surface, pose, settings).t_query_reference,
            None => *pose,
        };
        let judge = Judge::new(&clouds, &self.config.hypotheses);
        let candidates: Vec<Candidate> = (0..stages.fine.len().max(1))
            .map(|result| {
                let pair = stages.estimate_of(result, &clouds);
                let pose = refined(&pair.t_query_reference);
                Candidate { judged: judge.judge(&pose), pair, pose }
            })
            .collect();
        let best = (0..candidates.len())
            .reduce(|a, b| if candidates[b].judged.score > candidates[a].judged.score { b } else { a })
            .unwrap_or(0);
        let runner_up = candidates[best].runner_up(&candidates);
        let Candidate { pair, pose, judged } = &candidates[best];
        let numbers = [&pair.score, &pair.matched].into_iter().chain(&pair.overlap);
        if !pose.rotation.iter().chain(&pose.translation).chain(numbers).all(|x| x.is_finite()) {
            return Err(InferError::NotFinite);
        }
        let pose = *pose;
        let refine = start.elapsed().as_secs_f64();
        let evidence = Evidence {
            points: query.frame.measured_pixels(query.mask).count(),
            color: judged.agreement.color,
            in_front: judged.agreement.in_front,
            runner_up,
            ..pair.evidence
        };
        let judge = |calibration: &Calibration| {
            calibration.judge(&evidence, self.min_confidence.unwrap_or(calibration.threshold))
        };
        Ok(Estimate {
            refined: pose != pair.t_query_reference,
            t_query_reference: pose,
            score: pair.score,
            confidence: self.calibration.as_ref().map(judge),
            evidence,
            overlap: pair.overlap,
            matched: pair.matched,
            t_query_reference_coarse: pair.t_query_reference_coarse,
            timings: Timings { prepare, network, refine, total: prepare + network.total() + refine },
        })
    }
}
