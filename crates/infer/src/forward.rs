//! Poses of prepared pairs: network forward passes on the device, pose solving on the host.

use std::time::Instant;

use burn::tensor::Device;
use rayon::prelude::*;
use unopose_core::{
    config::{HypothesisScore, ModelConfig},
    geometry::{CoarsePose, Pose, coarse_pose},
};
use unopose_nn::{
    device::is_host,
    model::{
        CloudTensors, EncodedCloud, SparseRows, StructureTensors, Supervision, UnoPose, ViewTensors,
        into_group_tensors,
    },
};
use unopose_pairs::{
    appearance::Detail,
    data::{CloudInput, PreparedReference, positional_groups},
};

use super::{
    CloudPair, FineTrace, InferError, Judge, Matched, PairEstimate, PairTrace, StageTimes, Uniforms,
    host_assignments, pairs::with_positions, point_features::PointFeatures, trace::sparse_points,
};

/// Queries whose colours are computed together on the CPU: the backbone's weights are read once for all of them.
/// Everything else is done for each pair on its own, whose tensors fit into the caches better than those of several; the
/// pairs pass side by side, so that no core waits at the end of a stage.
const COLORS_ON_HOST: usize = 8;

/// Angle between the rotations of two starts of the fine stage, degrees; it corrects smaller ones by itself.
const STARTS_APART_DEG: f64 = 20.0;

/// Poses of pairs of equal sizes, each pair with its own reference. `model` must not be on the autodiff tape.
pub fn estimate_pairs(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[(&CloudInput, &PreparedReference)],
    uniforms: Uniforms<'_>,
    device: &Device,
) -> Result<Vec<PairEstimate>, InferError> {
    let network = Network { model, config, device };
    let at_once = if is_host(device) { 1 } else { pairs.len().max(1) };
    let mut estimates = Vec::with_capacity(pairs.len());
    for pairs in pairs.chunks(at_once) {
        let start = Instant::now();
        let references: Vec<&PreparedReference> = pairs.iter().map(|p| p.1).collect();
        let pairs: Vec<_> = pairs.iter().map(|(query, reference)| CloudPair::new(query, reference)).collect();
        let clouds = [
            pairs.iter().map(|pair| pair.query).collect::<Vec<&CloudInput>>(),
            pairs.iter().map(|pair| pair.reference).collect(),
        ];
        let [query, reference] = clouds.map(|clouds| CloudTensors::from_clouds(&clouds, config, device));
        let [query, reference] = model.encode_both(&query, &reference);
        let reference = with_positions(model, config, &references, reference, device);
        let times = StageTimes { encode: start.elapsed().as_secs_f64(), ..StageTimes::default() };
        let sampling = Sampling { uniforms, first: estimates.len(), given: None };
        let (traces, _) = network.match_encoded(&pairs, query, &reference, sampling, times)?;
        estimates.extend(traces.iter().zip(&pairs).map(|(trace, pair)| trace.estimate(pair)));
    }
    Ok(estimates)
}

/// [`estimate_pairs`] against references that are already encoded (one per pair, in order), with the stage times.
pub fn estimate_encoded(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[CloudPair<'_>],
    references: &[&EncodedCloud],
    uniforms: Uniforms<'_>,
    device: &Device,
) -> Result<(Vec<PairEstimate>, StageTimes), InferError> {
    let network = Network { model, config, device };
    let sampling = Sampling { uniforms, first: 0, given: None };
    network.map_encoded(pairs, references, sampling, |trace, pair| trace.estimate(pair))
}

/// [`estimate_encoded`] with everything that led to the poses. `given` are poses (matching frames, one per pair) where
/// the fine stage starts instead of at the coarse hypotheses.
pub fn trace_encoded(
    model: &UnoPose,
    config: &ModelConfig,
    pairs: &[CloudPair<'_>],
    references: &[&EncodedCloud],
    uniforms: Uniforms<'_>,
    given: Option<&[Pose]>,
    device: &Device,
) -> Result<(Vec<PairTrace>, StageTimes), InferError> {
    let network = Network { model, config, device };
    network.map_encoded(pairs, references, Sampling { uniforms, first: 0, given }, |trace, _| trace)
}

/// How the fine stage gets its starts: from sampled hypotheses, or `given` ones.
#[derive(Clone, Copy)]
struct Sampling<'a> {
    uniforms: Uniforms<'a>,
    /// Number of the first pair in the caller's list.
    first: usize,
    given: Option<&'a [Pose]>,
}

impl Sampling<'_> {
    /// For one of the pairs.
    fn of_pair(self, index: usize) -> Self {
        Self { first: self.first + index, given: self.given.map(|starts| &starts[index..=index]), ..self }
    }
}

#[derive(Clone, Copy)]
struct Network<'a> {
    model: &'a UnoPose,
    config: &'a ModelConfig,
    device: &'a Device,
}

impl Network<'_> {
    /// What `finish` makes of the pairs' traces; on the CPU of each as soon as it is there, since a trace holds the whole
    /// assignment (17 MB for 2048 points).
    fn map_encoded<T: Send>(
        &self,
        pairs: &[CloudPair<'_>],
        references: &[&EncodedCloud],
        sampling: Sampling<'_>,
        finish: impl Fn(PairTrace, &CloudPair<'_>) -> T + Sync,
    ) -> Result<(Vec<T>, StageTimes), InferError> {
        if !is_host(self.device) {
            let start = Instant::now();
            let Some(reference) = EncodedCloud::batch(references) else {
                return Ok((Vec::new(), StageTimes::default()));
            };
            let queries: Vec<&CloudInput> = pairs.iter().map(|pair| pair.query).collect();
            let query = self.model.encode(&CloudTensors::from_clouds(&queries, self.config, self.device));
            let times = StageTimes { encode: start.elapsed().as_secs_f64(), ..StageTimes::default() };
            let (traces, times) = self.match_encoded(pairs, query, &reference, sampling, times)?;
            return Ok((
                traces.into_iter().zip(pairs).map(|(trace, pair)| finish(trace, pair)).collect(),
                times,
            ));
        }
        let (mut finished, mut times) = (Vec::with_capacity(pairs.len()), StageTimes::default());
        for (pairs, references) in pairs.chunks(COLORS_ON_HOST).zip(references.chunks(COLORS_ON_HOST)) {
            let start = Instant::now();
            let queries: Vec<&CloudInput> = pairs.iter().map(|pair| pair.query).collect();
            let colors = self.model.colors(&ViewTensors::new(&queries, self.config, self.device));
            times.encode += start.elapsed().as_secs_f64();
            let (first, start) = (finished.len(), Instant::now());
            let matched: Vec<_> = pairs
                .par_iter()
                .zip(references)
                .enumerate()
                .map(|(index, (pair, &reference))| {
                    let start = Instant::now();
                    let structure = StructureTensors::new(&[pair.query], self.device);
                    let rows = SparseRows::new(&[pair.query], self.config, self.device);
                    let colors = colors.clone().narrow(0, index, 1);
                    let query = self.model.encode_structure(&structure, &rows, colors);
                    let spent = StageTimes { encode: start.elapsed().as_secs_f64(), ..StageTimes::default() };
                    let (pairs, sampling) = (std::slice::from_ref(pair), sampling.of_pair(first + index));
                    let (traces, spent) = self.match_encoded(pairs, query, reference, sampling, spent)?;
                    Ok((traces.into_iter().map(|trace| finish(trace, pair)).collect::<Vec<T>>(), spent))
                })
                .collect::<Result<_, InferError>>()?;
            let wall = start.elapsed().as_secs_f64();
            let all: f64 = matched.iter().map(|(_, spent)| spent.total()).sum();
            for (of_pair, spent) in matched {
                finished.extend(of_pair);
                times.add(&spent.scaled(wall / all.max(f64::MIN_POSITIVE)));
            }
        }
        Ok((finished, times))
    }

    /// Matching and pose solving, with their times added to `times`.
    fn match_encoded(
        &self,
        pairs: &[CloudPair<'_>],
        query: EncodedCloud,
        reference: &EncodedCloud,
        Sampling { uniforms, first, given }: Sampling<'_>,
        mut times: StageTimes,
    ) -> Result<(Vec<PairTrace>, StageTimes), InferError> {
        let &Self { model, config, .. } = self;
        let mut clock = Instant::now();
        let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64();
        let mut coarse = model.coarse(&query, reference, Supervision::LastBlock);
        let coarse = match coarse.pop() {
            Some(block) => host_assignments(block, config.overlap, config.quirks.score_split_at_reference)?,
            None => Vec::new(),
        };
        times.coarse = lap();

        let initial: Vec<_> = pairs
            .par_iter()
            .zip(&coarse)
            .enumerate()
            .map(|(index, (pair, matched))| {
                let CloudPair { query, reference, .. } = *pair;
                let coarse = coarse_pose(
                    &matched.assignment,
                    &sparse_points(query),
                    &sparse_points(reference),
                    &config.hypotheses,
                    uniforms.stream(first + index),
                    config.quirks.degenerate_triplets,
                );
                match config.hypotheses.score {
                    HypothesisScore::Distance => coarse,
                    HypothesisScore::MutualFit => {
                        let judge = Judge::new(pair, &config.hypotheses);
                        coarse.rescored(|pose| judge.score(pose, Detail::Blurred))
                    }
                }
            })
            .collect();
        times.hypotheses = lap();

        let starts: Vec<Vec<Pose>> = match given {
            Some(starts) => starts.iter().map(|&start| vec![start]).collect(),
            None => initial.iter().map(|coarse| different_starts(coarse, config.hypotheses.starts)).collect(),
        };
        let mut fine: Vec<Vec<FineTrace>> = vec![Vec::new(); pairs.len()];
        let rounds =
            if model.fine_point_matching.is_some() { starts.iter().map(Vec::len).max() } else { None };
        for round in 0..rounds.unwrap_or(0) {
            // A pair with fewer starts repeats its last one, so that all pairs stay one batch.
            let now: Vec<Pose> = starts.iter().map(|of_pair| of_pair[round.min(of_pair.len() - 1)]).collect();
            let matched = self.fine(pairs, &query, reference, &now)?;
            times.fine += lap();
            fine.par_iter_mut().zip(pairs).zip(now.into_par_iter().zip(matched)).for_each(
                |((results, pair), (start, matched))| {
                    results.push(FineTrace::new(pair, start, matched, &config.hypotheses));
                },
            );
            times.solve += lap();
        }
        for (results, starts) in fine.iter_mut().zip(&starts) {
            results.truncate(starts.len());
            results.sort_by(|a, b| b.judged.total_cmp(&a.judged));
        }
        let mut features = match config.hypotheses.feature_weight > 0.0 {
            true => PointFeatures::of_batch(&query.dense)?.into_iter(),
            false => Vec::new().into_iter(),
        };
        let stages = coarse.into_iter().zip(initial).zip(fine);
        let trace = |((coarse, coarse_pose), fine)| PairTrace {
            coarse,
            coarse_pose,
            fine,
            features: features.next(),
        };
        Ok((stages.map(trace).collect(), times))
    }

    /// Assignments of the dense points when the query, moved by its start, gets its positional encoding.
    fn fine(
        &self,
        pairs: &[CloudPair<'_>],
        query: &EncodedCloud,
        reference: &EncodedCloud,
        starts: &[Pose],
    ) -> Result<Vec<Matched>, InferError> {
        let &Self { model, config, device } = self;
        let Some(stage) = &model.fine_point_matching else { return Ok(Vec::new()) };
        let groups: Vec<_> = pairs
            .par_iter()
            .zip(starts)
            .map(|(pair, start)| {
                let t_reference_query = start.inverse();
                let moved: Vec<[f32; 3]> =
                    pair.query.points.iter().map(|p| t_reference_query.transform_f32(p)).collect();
                positional_groups(&moved, config)
            })
            .collect();
        let groups = into_group_tensors(groups, config, device);
        let query = EncodedCloud { position: Some(stage.position(&groups)), ..query.clone() };
        let block = model.fine(&query, reference, Supervision::LastBlock).pop();
        Ok(block.map(|block| host_assignments(block, config.overlap, false)).transpose()?.unwrap_or_default())
    }
}

/// The poses of the best scored hypotheses that are turned against each other, at most `count`, the best first.
fn different_starts(coarse: &CoarsePose, count: usize) -> Vec<Pose> {
    let mut starts = vec![coarse.pose];
    let mut order: Vec<usize> = (0..coarse.kept.len()).collect();
    order.sort_by(|&a, &b| coarse.kept_scores[b].total_cmp(&coarse.kept_scores[a]));
    for index in order {
        if starts.len() >= count {
            break;
        }
        let pose = &coarse.hypotheses[coarse.kept[index]].pose;
        if starts.iter().all(|start| start.rotation_angle_deg(pose) > STARTS_APART_DEG) {
            starts.push(*pose);
        }
    }
    starts
}
