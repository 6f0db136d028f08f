//! Poses of prepared pairs: network forward passes on the device, pose solving on the host.

use std::time::Instant;

use burn::tensor::{Device, Tensor};
use rayon::prelude::*;

use super::{Evidence, InferError, Matched, PairTrace, Uniforms, host_assignments, trace::sparse_points};
use crate::{
    config::{HypothesisScore, ModelConfig},
    data::{CloudInput, PreparedReference, positional_groups},
    geometry::{MutualFit, Pose, coarse_pose},
    model::{CloudFeatures, CloudTensors, Supervision, UnoPose, group_tensors},
};

/// Pose of one pair with what explains it.
#[derive(Clone, Debug)]
pub struct PairEstimate {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// Confidence in [0, 1]: share of matched query points that lie on the reference, times the share matched
    /// (section 6; without a fine stage computed on the coarse matches).
    pub score: f64,
    /// Coarse pose, metres.
    pub t_query_reference_coarse: Pose,
    /// Score of the coarse hypothesis, see [`HypothesisScore`].
    pub coarse_score: f64,
    /// Mean predicted overlap of the query's and the reference's points.
    pub overlap: [f64; 2],
    /// Share of query points matched to a reference point.
    pub matched: f64,
    /// What speaks for the pose.
    pub evidence: Evidence,
}

/// Where the time of a batch went.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct StageTimes {
    /// Colour features and structure embeddings, seconds.
    pub encode: f64,
    /// Coarse matching, seconds.
    pub coarse: f64,
    /// Hypotheses, seconds.
    pub hypotheses: f64,
    /// Positional encoding and fine matching, seconds.
    pub fine: f64,
    /// Weighted Procrustes and scoring, seconds.
    pub solve: f64,
}

impl StageTimes {
    /// Of one of `count` pairs.
    pub fn divided(&self, count: usize) -> Self {
        let share = |seconds: f64| seconds / count.max(1) as f64;
        Self {
            encode: share(self.encode),
            coarse: share(self.coarse),
            hypotheses: share(self.hypotheses),
            fine: share(self.fine),
            solve: share(self.solve),
        }
    }

    pub fn total(&self) -> f64 {
        self.encode + self.coarse + self.hypotheses + self.fine + self.solve
    }
}

/// What the network computes of a reference (or a batch of them) without a query, on the device.
#[derive(Clone, Debug)]
pub struct EncodedReferences {
    pub(super) features: CloudFeatures,
    /// Positional encoding `[B, N, C]`, absent without a fine stage.
    pub(super) position: Option<Tensor<3>>,
}

/// A query's cloud and the reference's, both in units of the reference's radius.
#[derive(Clone, Copy, Debug)]
pub struct CloudPair<'a> {
    pub query: &'a CloudInput,
    pub reference: &'a CloudInput,
    /// The reference's, metres.
    pub radius: f32,
}

impl<'a> CloudPair<'a> {
    pub fn new(query: &'a CloudInput, reference: &'a PreparedReference) -> Self {
        Self { query, reference: &reference.cloud, radius: reference.radius }
    }
}

impl EncodedReferences {
    /// Several as one batch, in order; `None` for none.
    pub fn batch(items: &[&Self]) -> Option<Self> {
        fn joined<const D: usize>(tensors: impl Iterator<Item = Tensor<D>>) -> Tensor<D> {
            Tensor::cat(tensors.collect(), 0)
        }
        let all = || items.iter();
        let positions: Option<Vec<_>> = all().map(|item| item.position.clone()).collect();
        (!items.is_empty()).then(|| Self {
            features: CloudFeatures {
                dense: joined(all().map(|item| item.features.dense.clone())),
                embedding: joined(all().map(|item| item.features.embedding.clone())),
            },
            position: positions.map(|positions| joined(positions.into_iter())),
        })
    }

    /// Size on the device.
    pub fn bytes(&self) -> usize {
        let position = self.position.as_ref().map_or(0, |p| p.shape().num_elements());
        let numbers =
            self.features.dense.shape().num_elements() + self.features.embedding.shape().num_elements();
        4 * (numbers + position)
    }
}

/// Runs the reference's share of the network.
pub fn encode_references(
    model: &UnoPose,
    config: &ModelConfig,
    references: &[&PreparedReference],
    device: &Device,
) -> EncodedReferences {
    let clouds: Vec<&CloudInput> = references.iter().map(|r| &r.cloud).collect();
    let features = model.encode(&CloudTensors::from_clouds(&clouds, config, device));
    with_positions(model, config, references, features, device)
}

/// Adds what the fine stage needs of the references.
fn with_positions(
    model: &UnoPose,
    config: &ModelConfig,
    references: &[&PreparedReference],
    features: CloudFeatures,
    device: &Device,
) -> EncodedReferences {
    let groups: Vec<_> = references.iter().map(|r| &r.groups).collect();
    let position = model
        .fine_point_matching
        .as_ref()
        .map(|stage| stage.position(&group_tensors(&groups, config, device)));
    EncodedReferences { features, position }
}

/// Poses of pairs of equal sizes, each pair with its own reference. `model` must not be on the autodiff tape.
pub fn estimate_pairs(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[(&CloudInput, &PreparedReference)],
    uniforms: Uniforms<'_>,
    device: &Device,
) -> Result<Vec<PairEstimate>, InferError> {
    let references: Vec<&PreparedReference> = pairs.iter().map(|p| p.1).collect();
    let pairs: Vec<_> = pairs.iter().map(|(query, reference)| CloudPair::new(query, reference)).collect();
    let Some([query, reference]) = cloud_tensors(&pairs, config, device) else { return Ok(Vec::new()) };
    let start = Instant::now();
    let [query_features, features] = model.encode_both(&query, &reference);
    let encoded = with_positions(model, config, &references, features, device);
    let clouds = EncodedClouds { query, query_features, reference, references: &encoded };
    let times = StageTimes { encode: start.elapsed().as_secs_f64(), ..StageTimes::default() };
    let sampling = Sampling { uniforms, given: None };
    let (traces, _) = match_encoded(model, config, &pairs, &clouds, sampling, device, times)?;
    Ok(estimates(&traces, &pairs))
}

/// [`estimate_pairs`] against references that are already encoded (one per pair, in order), with the stage times.
pub fn estimate_encoded(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[CloudPair<'_>],
    references: &EncodedReferences,
    uniforms: Uniforms<'_>,
    device: &Device,
) -> Result<(Vec<PairEstimate>, StageTimes), InferError> {
    let (traces, times) = trace_encoded(model, config, pairs, references, uniforms, None, device)?;
    Ok((estimates(&traces, pairs), times))
}

fn estimates(traces: &[PairTrace], pairs: &[CloudPair<'_>]) -> Vec<PairEstimate> {
    traces.iter().zip(pairs).map(|(trace, pair)| trace.estimate(pair)).collect()
}

/// [`estimate_encoded`] with everything that led to the poses. `given` are poses (matching frames, one per pair) where
/// the fine stage starts instead of at the coarse hypotheses.
pub fn trace_encoded(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[CloudPair<'_>],
    references: &EncodedReferences,
    uniforms: Uniforms<'_>,
    given: Option<&[Pose]>,
    device: &Device,
) -> Result<(Vec<PairTrace>, StageTimes), InferError> {
    let start = Instant::now();
    let Some([query, reference]) = cloud_tensors(pairs, config, device) else {
        return Ok((Vec::new(), StageTimes::default()));
    };
    let query_features = model.encode(&query);
    let clouds = EncodedClouds { query, query_features, reference, references };
    let times = StageTimes { encode: start.elapsed().as_secs_f64(), ..StageTimes::default() };
    match_encoded(model, config, pairs, &clouds, Sampling { uniforms, given }, device, times)
}

/// Queries and references of the pairs; `None` for no pairs.
fn cloud_tensors(
    pairs: &[CloudPair<'_>],
    config: &ModelConfig,
    device: &Device,
) -> Option<[CloudTensors; 2]> {
    let queries: Vec<&CloudInput> = pairs.iter().map(|pair| pair.query).collect();
    let references: Vec<&CloudInput> = pairs.iter().map(|pair| pair.reference).collect();
    (!pairs.is_empty())
        .then(|| [queries, references].map(|clouds| CloudTensors::from_clouds(&clouds, config, device)))
}

/// Both sides of the pairs, encoded.
struct EncodedClouds<'a> {
    query: CloudTensors,
    query_features: CloudFeatures,
    reference: CloudTensors,
    references: &'a EncodedReferences,
}

/// How the fine stage gets its starts: from sampled hypotheses, or `given` ones.
#[derive(Clone, Copy)]
struct Sampling<'a> {
    uniforms: Uniforms<'a>,
    given: Option<&'a [Pose]>,
}

/// Matching and pose solving, with their times added to `times`.
fn match_encoded(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[CloudPair<'_>],
    clouds: &EncodedClouds<'_>,
    Sampling { uniforms, given }: Sampling<'_>,
    device: &Device,
    mut times: StageTimes,
) -> Result<(Vec<PairTrace>, StageTimes), InferError> {
    let EncodedClouds { query, query_features, reference, references } = clouds;
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
    let coarse =
        model.coarse((query, query_features), (reference, &references.features), Supervision::LastBlock);
    let coarse = match coarse.last() {
        Some(block) => host_assignments(block, config.overlap, config.quirks.score_split_at_reference)?,
        None => Vec::new(),
    };
    times.coarse = lap();

    let initial: Vec<_> = pairs
        .par_iter()
        .zip(&coarse)
        .enumerate()
        .map(|(index, (&CloudPair { query, reference, .. }, matched))| {
            let coarse = coarse_pose(
                &matched.assignment,
                &sparse_points(query),
                &sparse_points(reference),
                &config.hypotheses,
                uniforms.stream(index),
                config.quirks.degenerate_triplets,
            );
            match config.hypotheses.score {
                HypothesisScore::Distance => coarse,
                HypothesisScore::MutualFit => {
                    let fit = MutualFit::new(&query.points, &reference.points);
                    coarse.rescored(|pose| fit.score(pose))
                }
            }
        })
        .collect();
    times.hypotheses = lap();

    let starts: Vec<Pose> = match given {
        Some(starts) => starts.to_vec(),
        None => initial.iter().map(|coarse| coarse.pose).collect(),
    };
    let fine = match (&model.fine_point_matching, &references.position) {
        (Some(stage), Some(reference_position)) => {
            let groups: Vec<_> = pairs
                .par_iter()
                .zip(&starts)
                .map(|(pair, start)| {
                    let t_reference_query = start.inverse();
                    let moved: Vec<[f32; 3]> =
                        pair.query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
                    positional_groups(&moved, config)
                })
                .collect();
            let groups = group_tensors(&groups.iter().collect::<Vec<_>>(), config, device);
            let blocks = model.fine(
                (query, query_features, stage.position(&groups)),
                (reference, &references.features, reference_position.clone()),
                Supervision::LastBlock,
            );
            blocks.last().map(|block| host_assignments(block, config.overlap, false)).transpose()?
        }
        _ => None,
    };
    times.fine = lap();

    let fine: Vec<Option<Matched>> = match fine {
        Some(fine) => fine.into_iter().map(Some).collect(),
        None => vec![None; pairs.len()],
    };
    let stages: Vec<_> = coarse.into_iter().zip(initial).zip(starts).zip(fine).collect();
    let traces = pairs
        .par_iter()
        .zip(stages)
        .map(|(pair, (((coarse, initial), start), fine))| {
            PairTrace::new(pair, (coarse, initial), (start, fine))
        })
        .collect();
    times.solve = lap();
    Ok((traces, times))
}
