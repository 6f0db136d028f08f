//! [`PoseEstimator`]: a loaded network with what surrounds it.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::OnceLock,
    time::Instant,
};

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use unopose_core::{
    config::{Config, ModelConfig},
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_nn::{
    checkpoint::{self, Meta},
    device::DeviceChoice,
    model::{EncodedCloud, UnoPose},
};
use unopose_pairs::data::{CloudInput, normalised_pose, prepare_query, prepare_reference};

use super::{
    Calibration, Candidate, Choice, CloudPair, Estimate, Evidence, InferError, PairTrace, Query, Reference,
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
    /// What the checkpoint says besides weights and configuration.
    pub(super) metadata: BTreeMap<String, String>,
    /// Replaces the calibration's threshold.
    pub(super) min_confidence: Option<f64>,
    /// See [`PoseEstimator::network`].
    pub(super) network: OnceLock<String>,
}

impl PoseEstimator {
    /// The network of a checkpoint, with the configuration inside it.
    pub fn load(path: &Path, device: DeviceChoice) -> Result<Self, InferError> {
        let opened = device.open()?;
        let loaded = checkpoint::load(path, &opened.0)?;
        Self::from_loaded(loaded, opened, path.display().to_string())
    }

    /// The network of a checkpoint that was written without its backbone, completed by the DINOv2 weights in `backbone`.
    pub fn load_with_backbone(
        path: &Path,
        backbone: &Path,
        device: DeviceChoice,
    ) -> Result<Self, InferError> {
        let opened = device.open()?;
        let loaded = checkpoint::load_with_backbone(path, backbone, &opened.0)?;
        Self::from_loaded(loaded, opened, path.display().to_string())
    }

    /// The network that is compiled in; an error in builds without one.
    pub fn embedded(device: DeviceChoice) -> Result<Self, InferError> {
        let bytes = unopose_checkpoints::GEO.ok_or(InferError::NoCheckpoint { looked: Vec::new() })?;
        let opened = device.open()?;
        let name = format!("embedded {DEFAULT_CHECKPOINT}");
        let loaded = checkpoint::load_bytes(bytes, &name, &opened.0)?;
        Self::from_loaded(loaded, opened, name)
    }

    /// With what the checkpoint says besides its weights.
    fn from_loaded(
        (model, config, meta): (UnoPose, Config, Meta),
        (device, backend): (Device, DeviceChoice),
        source: String,
    ) -> Result<Self, InferError> {
        let calibration = Calibration::from_metadata(&meta.extra, Path::new(&source))?;
        let estimator = Self::new(model, config.model, device, backend, source);
        Ok(Self { calibration, metadata: meta.extra, ..estimator })
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
            metadata: BTreeMap::new(),
            min_confidence: None,
            network: OnceLock::new(),
        }
    }

    /// Entries of the checkpoint's metadata besides step and configuration; none of a network in memory.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
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
            features: OnceLock::new(),
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
        self.estimate_refined(queries, self.refinement)
    }

    /// [`Self::estimate_batch`] with another refinement.
    pub(super) fn estimate_refined(
        &self,
        queries: &[Query<'_>],
        refinement: Refinement,
    ) -> Vec<Result<Estimate, InferError>> {
        let prepared: Vec<Result<(CloudInput, f64), InferError>> =
            queries.par_iter().map(|query| self.prepare(query)).collect();
        let usable: Vec<(&Query<'_>, &CloudInput, f64)> = queries
            .iter()
            .zip(&prepared)
            .filter_map(|(query, prepared)| prepared.as_ref().ok().map(|(cloud, t)| (query, cloud, *t)))
            .collect();
        let estimates: Vec<Result<Estimate, InferError>> =
            usable.chunks(MAX_BATCH).flat_map(|chunk| self.estimate_chunk(chunk, refinement)).collect();
        let mut estimates = estimates.into_iter();
        let mut next = |_| estimates.next().unwrap_or(Err(InferError::Incomplete));
        prepared.into_iter().map(|prepared| prepared.and_then(&mut next)).collect()
    }

    /// One instance with everything that led to its pose.
    pub fn trace(&self, query: &Query<'_>) -> Result<Trace, InferError> {
        let (cloud, prepare) = self.prepare(query)?;
        let (mut traces, times) = self.run(&[(query, &cloud, prepare)], None)?;
        let stages = traces.pop().ok_or(InferError::Incomplete)?;
        let start = Instant::now();
        let choice = self.choose(query, &cloud, &stages, self.refinement);
        let times = (times, start.elapsed().as_secs_f64());
        let estimate = self.finish(query, prepare, &choice, times)?;
        let candidates = choice.candidates.iter().map(|candidate| candidate.pose).collect();
        Ok(Trace { estimate, stages, cloud, candidates })
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

    fn estimate_chunk(
        &self,
        chunk: &[(&Query<'_>, &CloudInput, f64)],
        refinement: Refinement,
    ) -> Vec<Result<Estimate, InferError>> {
        match self.run(chunk, None) {
            Ok((traces, times)) => {
                let share = times.divided(chunk.len());
                chunk
                    .par_iter()
                    .zip(traces)
                    .map(|((query, cloud, prepare), stages)| {
                        let start = Instant::now();
                        let choice = self.choose(query, cloud, &stages, refinement);
                        self.finish(query, *prepare, &choice, (share, start.elapsed().as_secs_f64()))
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

    fn finish(
        &self,
        query: &Query<'_>,
        prepare: f64,
        choice: &Choice,
        (network, refine): (StageTimes, f64),
    ) -> Result<Estimate, InferError> {
        let Candidate { pair, pose, judged, .. } = choice.best();
        let numbers = [&pair.score, &pair.matched].into_iter().chain(&pair.overlap);
        if !pose.rotation.iter().chain(&pose.translation).chain(numbers).all(|x| x.is_finite()) {
            return Err(InferError::NotFinite);
        }
        let pose = *pose;
        let evidence = Evidence {
            points: query.frame.measured_pixels(query.mask).count(),
            color: judged.agreement.color,
            in_front: judged.agreement.in_front,
            runner_up: choice.runner_up(),
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
            alternatives: choice.alternatives(),
            free_axis: choice.free_axis,
            overlap: pair.overlap,
            matched: pair.matched,
            t_query_reference_coarse: pair.t_query_reference_coarse,
            timings: Timings { prepare, network, refine, total: prepare + network.total() + refine },
        })
    }
}
