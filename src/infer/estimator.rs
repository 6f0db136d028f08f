//! [`PoseEstimator`]: a loaded network with what surrounds it.

use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
    time::Instant,
};

use burn::tensor::Device;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    EncodedReferences, InferError, PairEstimate, Reference, Refinement, StageTimes, Uniforms,
    encode_references, estimate_encoded,
};
use crate::{
    checkpoint,
    config::ModelConfig,
    data::{CloudInput, PreparedReference, prepare_query, prepare_reference},
    device::DeviceChoice,
    frame::{Mask, RgbdFrame},
    geometry::Pose,
    model::UnoPose,
    registration::icp::refine_with,
};

/// Where the default checkpoint lies, beside the binary or in the working directory.
const DEFAULT_CHECKPOINT: &str = "checkpoints/geo.safetensors";
#[cfg(embedded_checkpoint)]
const EMBEDDED: Option<&[u8]> =
    Some(include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/checkpoints/geo.safetensors")));
#[cfg(not(embedded_checkpoint))]
const EMBEDDED: Option<&[u8]> = None;

/// Largest batch of one forward pass, which bounds memory. On two CPU cores batches of 1, 2 and 8 take the same time per
/// pair within the noise (`unoinfer eval` on 120 pairs) and give the same bits; a GPU gains.
const MAX_BATCH: usize = 8;

/// Streams of the random numbers of one seed.
const REFERENCE_STREAM: u64 = 1;
const QUERY_STREAM: u64 = 2;

/// Estimates poses of instances against reference views.
#[derive(Debug)]
pub struct PoseEstimator {
    pub(super) model: UnoPose,
    pub(super) config: ModelConfig,
    pub(super) device: Device,
    backend: DeviceChoice,
    /// Where the weights come from.
    source: String,
    seed: u64,
    refinement: Refinement,
}

/// A query instance and the reference it is compared with.
#[derive(Clone, Copy)]
pub struct Query<'a> {
    pub reference: &'a Reference,
    pub frame: &'a RgbdFrame,
    pub mask: &'a Mask,
}

/// The pose of one instance with what explains it.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// Confidence in [0, 1]: share of the query's points that are matched and lie on the reference.
    pub score: f64,
    /// Predicted share of the query's points that the reference sees, and of the reference's that the query sees.
    pub overlap: [f64; 2],
    /// Share of the query's points matched to a reference point.
    pub matched: f64,
    /// The pose of the coarse stage, metres.
    pub t_query_reference_coarse: Pose,
    /// Whether a refinement replaced the network's pose.
    pub refined: bool,
    pub timings: Timings,
}

/// Seconds per instance; what a batch shares is divided evenly.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Timings {
    /// Crop, sampling, reference frame, structure.
    pub prepare: f64,
    #[serde(flatten)]
    pub network: StageTimes,
    pub refine: f64,
    pub total: f64,
}

impl PoseEstimator {
    /// The network of a checkpoint, with the configuration inside it.
    pub fn load(path: &Path, device: DeviceChoice) -> Result<Self, InferError> {
        let (device, backend) = device.open()?;
        let (model, config, _) = checkpoint::load(path, &device)?;
        Ok(Self::new(model, config.model, device, backend, path.display().to_string()))
    }

    /// The network that is compiled in; an error in builds without one.
    pub fn embedded(device: DeviceChoice) -> Result<Self, InferError> {
        let bytes = EMBEDDED.ok_or(InferError::NoCheckpoint { looked: Vec::new() })?;
        let (device, backend) = device.open()?;
        let name = format!("embedded {DEFAULT_CHECKPOINT}");
        let (model, config, _) = checkpoint::load_bytes(bytes, &name, &device)?;
        Ok(Self::new(model, config.model, device, backend, name))
    }

    /// `checkpoints/geo.safetensors` beside the binary, else in the working directory, else the embedded one.
    pub fn load_default(device: DeviceChoice) -> Result<Self, InferError> {
        let beside =
            std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(DEFAULT_CHECKPOINT)));
        let looked: Vec<PathBuf> = beside.into_iter().chain([PathBuf::from(DEFAULT_CHECKPOINT)]).collect();
        match looked.iter().find(|path| path.is_file()) {
            Some(path) => Self::load(path, device),
            None if EMBEDDED.is_some() => Self::embedded(device),
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
        Self { model, config, device, backend, source, seed: 0, refinement: Refinement::None }
    }

    /// Seed of point sampling and hypotheses, 0 at first.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Refinement after the network, none at first.
    pub fn with_refinement(mut self, refinement: Refinement) -> Self {
        self.refinement = refinement;
        self
    }

    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    pub fn refinement(&self) -> Refinement {
        self.refinement
    }

    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Where the weights come from.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The backend in use.
    pub fn backend(&self) -> DeviceChoice {
        self.backend
    }

    /// Prepares and encodes a reference view of an object.
    pub fn reference(&self, frame: &RgbdFrame, mask: &Mask) -> Result<Reference, InferError> {
        let start = Instant::now();
        let mut rng = self.stream(REFERENCE_STREAM);
        let prepared =
            prepare_reference(frame, mask, &self.config, &mut rng).map_err(InferError::Reference)?;
        let encoded = encode_references(&self.model, &self.config, &[&prepared], &self.device);
        let reference = Reference {
            prepared,
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
        let mut estimates: Vec<Result<Estimate, InferError>> =
            usable.chunks(MAX_BATCH).flat_map(|chunk| self.estimate_chunk(chunk)).collect();
        let mut in_order = estimates.drain(..);
        prepared
            .into_iter()
            .map(|prepared| match prepared {
                Ok(_) => in_order.next().unwrap_or(Err(InferError::NotFinite)),
                Err(error) => Err(error),
            })
            .collect()
    }

    fn prepare(&self, query: &Query<'_>) -> Result<(CloudInput, f64), InferError> {
        let start = Instant::now();
        let mut rng = self.stream(QUERY_STREAM);
        let radius = query.reference.prepared.radius;
        let cloud = prepare_query(query.frame, query.mask, radius, &self.config, &mut rng);
        Ok((cloud.map_err(InferError::Query)?, start.elapsed().as_secs_f64()))
    }

    fn estimate_chunk(&self, chunk: &[(&Query<'_>, &CloudInput, f64)]) -> Vec<Result<Estimate, InferError>> {
        let pairs: Vec<(&CloudInput, &PreparedReference)> =
            chunk.iter().map(|(query, cloud, _)| (*cloud, &query.reference.prepared)).collect();
        let references: Vec<&EncodedReferences> = chunk.iter().map(|(q, ..)| &q.reference.encoded).collect();
        let Some(references) = EncodedReferences::batch(&references) else { return Vec::new() };
        let uniforms = Uniforms::Shared(self.seed);
        match estimate_encoded(&self.model, &self.config, &pairs, &references, uniforms, &self.device) {
            Ok((estimates, times)) => {
                let share = times.divided(chunk.len());
                chunk
                    .par_iter()
                    .zip(estimates)
                    .map(|((query, _, prepare), pair)| self.finish(query, *prepare, pair, share))
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

    fn finish(
        &self,
        query: &Query<'_>,
        prepare: f64,
        pair: PairEstimate,
        network: StageTimes,
    ) -> Result<Estimate, InferError> {
        let start = Instant::now();
        let mut pose = pair.t_query_reference;
        if !pose.rotation.iter().chain(&pose.translation).all(|x| x.is_finite()) {
            return Err(InferError::NotFinite);
        }
        if let Some(settings) = self.refinement.settings()
            && let Some(surface) = query.reference.surface()
        {
            let points = query.frame.masked_points(query.mask);
            pose = refine_with(&points, surface, &pose, &settings).t_query_reference;
        }
        let refine = start.elapsed().as_secs_f64();
        Ok(Estimate {
            refined: pose != pair.t_query_reference,
            t_query_reference: pose,
            score: pair.score,
            overlap: pair.overlap,
            matched: pair.matched,
            t_query_reference_coarse: pair.t_query_reference_coarse,
            timings: Timings { prepare, network, refine, total: prepare + network.total() + refine },
        })
    }

    pub(super) fn stream(&self, stream: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(stream);
        rng
    }
}
