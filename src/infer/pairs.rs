//! Poses of prepared pairs: network forward passes on the device, pose solving on the host.

use std::time::Instant;

use burn::tensor::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{InferError, Matched, host_assignments};
use crate::{
    config::ModelConfig,
    data::{CloudInput, PreparedReference, metric_pose, positional_groups},
    geometry::{Pose, coarse_pose, fine_pose},
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
    /// Coarse hypothesis score, 1/radius.
    pub coarse_score: f64,
    /// Mean predicted overlap of the query's and the reference's points.
    pub overlap: [f64; 2],
    /// Share of query points matched to a reference point.
    pub matched: f64,
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

/// Where the uniform numbers that sample the hypotheses come from.
#[derive(Clone, Copy, Debug)]
pub enum Uniforms<'a> {
    /// A stream per pair from a seed and the pair's position in the list.
    Seed(u64),
    /// The same stream for every pair: a pose does not depend on the pairs around it.
    Shared(u64),
    /// Given numbers in [0, 1), one list per pair (parity checks).
    Given(&'a [Vec<f32>]),
}

impl Uniforms<'_> {
    fn stream(&self, index: usize) -> impl FnMut() -> f32 {
        let (seed, stream) = match self {
            Self::Seed(seed) => (*seed, index as u64),
            Self::Shared(seed) => (*seed, 0),
            Self::Given(_) => (0, 0),
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        let mut given = match self {
            Self::Seed(_) | Self::Shared(_) => None,
            Self::Given(lists) => Some(lists.get(index).into_iter().flatten().copied()),
        };
        move || match &mut given {
            None => rng.random(),
            Some(list) => list.next().unwrap_or(0.0),
        }
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
    let cloud = CloudTensors::from_clouds(&clouds, config, device);
    let features = model.encode(&cloud);
    let position = model.fine_point_matching.as_ref().map(|stage| {
        let groups: Vec<_> = references.iter().map(|r| &r.groups).collect();
        stage.position(&group_tensors(&groups, config, device))
    });
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
    let encoded = encode_references(model, config, &references, device);
    let pairs: Vec<_> = pairs.iter().map(|(query, reference)| CloudPair::new(query, reference)).collect();
    Ok(estimate_encoded(model, config, &pairs, &encoded, uniforms, device)?.0)
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
    let mut times = StageTimes::default();
    let mut clock = Instant::now();
    let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
    if pairs.is_empty() {
        return Ok((Vec::new(), times));
    }
    let queries: Vec<&CloudInput> = pairs.iter().map(|pair| pair.query).collect();
    let query = CloudTensors::from_clouds(&queries, config, device);
    let query_features = model.encode(&query);
    let clouds: Vec<&CloudInput> = pairs.iter().map(|pair| pair.reference).collect();
    let reference = CloudTensors::from_clouds(&clouds, config, device);
    times.encode = lap();

    let coarse =
        model.coarse((&query, &query_features), (&reference, &references.features), Supervision::LastBlock);
    let coarse = match coarse.last() {
        Some(block) => host_assignments(block, config.overlap, config.quirks.score_split_at_reference)?,
        None => Vec::new(),
    };
    times.coarse = lap();

    let initial: Vec<_> = pairs
        .par_iter()
        .zip(&coarse)
        .enumerate()
        .map(|(index, (pair, matched))| {
            let sparse = |cloud: &CloudInput| -> Vec<[f32; 3]> {
                cloud.sparse.iter().map(|&i| cloud.points[i as usize]).collect()
            };
            coarse_pose(
                &matched.assignment,
                &sparse(pair.query),
                &sparse(pair.reference),
                &config.hypotheses,
                uniforms.stream(index),
                config.quirks.degenerate_triplets,
            )
        })
        .collect();
    times.hypotheses = lap();

    let fine = match (&model.fine_point_matching, &references.position) {
        (Some(stage), Some(reference_position)) => {
            let groups: Vec<_> = pairs
                .par_iter()
                .zip(&initial)
                .map(|(pair, coarse)| {
                    let t_reference_query = coarse.pose.inverse();
                    let moved: Vec<[f32; 3]> =
                        pair.query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
                    positional_groups(&moved, config)
                })
                .collect();
            let groups = group_tensors(&groups.iter().collect::<Vec<_>>(), config, device);
            let blocks = model.fine(
                (&query, &query_features, stage.position(&groups)),
                (&reference, &references.features, reference_position.clone()),
                Supervision::LastBlock,
            );
            blocks.last().map(|block| host_assignments(block, config.overlap, false)).transpose()?
        }
        _ => None,
    };
    times.fine = lap();

    let estimates = pairs
        .par_iter()
        .enumerate()
        .map(|(index, &CloudPair { query, reference, radius })| {
            let metric = |pose: &Pose| metric_pose(pose, query.center, reference.center, radius);
            let coarse_pose = &initial[index];
            let matched = fine.as_ref().map_or(&coarse[index], |fine| &fine[index]);
            let (pose, score) = match &fine {
                Some(_) => {
                    let solved = fine_pose(&matched.assignment, &query.points, &reference.points);
                    (solved.pose, solved.score)
                }
                None => (coarse_pose.pose, coarse_confidence(query, reference, &coarse_pose.pose, matched)),
            };
            let foreground = matched.assignment.foreground_query();
            PairEstimate {
                t_query_reference: metric(&pose),
                score,
                t_query_reference_coarse: metric(&coarse_pose.pose),
                coarse_score: coarse_pose.score,
                overlap: matched.mean_overlap,
                matched: foreground.iter().map(|&f| f as f64).sum::<f64>() / foreground.len().max(1) as f64,
            }
        })
        .collect();
    times.solve = lap();
    Ok((estimates, times))
}

/// The fine stage's confidence (section 6) on the coarse matches.
fn coarse_confidence(query: &CloudInput, reference: &CloudInput, pose: &Pose, matched: &Matched) -> f64 {
    let t_reference_query = pose.inverse();
    let moved: Vec<[f32; 3]> =
        query.sparse.iter().map(|&i| t_reference_query.transform_f32(&query.points[i as usize])).collect();
    let distances = crate::geometry::nearest_distances(&moved, &reference.points);
    let foreground = matched.assignment.foreground_query();
    let total: f64 = foreground.iter().map(|&f| f as f64).sum();
    let near: f64 =
        foreground.iter().zip(&distances).filter(|(_, d)| **d < 0.15).map(|(&f, _)| f as f64).sum();
    near / (total + 1e-8) * (total / foreground.len().max(1) as f64)
}
