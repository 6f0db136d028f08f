//! Scores of several methods on the same targets.

use std::collections::BTreeMap;

use serde::Serialize;
use unopose_dataset::protocol::TargetList;
use unopose_eval::metrics::{Evaluation, Interval, Scores, average_recall_interval, paired_difference};

use super::{
    facts::{ListFacts, OverlapBin, overlap_bins, skipped_by_reason},
    run::MethodRun,
};

/// Draws of an interval.
const RESAMPLES: usize = 2000;

/// One method's row.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct MethodScore {
    pub name: String,
    /// 95 %, images resampled.
    pub ar: Interval,
    pub scores: Scores,
    /// Pairs that have a pose, and the mean of their times (-1 without any).
    pub pairs: usize,
    pub mean_time_per_pair_s: f64,
    /// Targets that no estimate answers; they count as missed.
    pub targets_without_pose: usize,
    /// Why instances have no pose, most frequent first. Items skipped for bad input are among them.
    pub rejections: Vec<(String, usize)>,
}

/// `a - b` of the average recalls on the same targets.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Difference {
    pub a: String,
    pub b: String,
    pub ar: Interval,
}

/// All methods.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Comparison {
    pub dataset: String,
    #[serde(flatten)]
    pub facts: ListFacts,
    pub targets: usize,
    /// Detections skipped for bad input, by reason.
    pub skipped_detections: Vec<(String, usize)>,
    /// Overlap ratios by the angle to the reference.
    pub overlaps: Vec<OverlapBin>,
    pub seed: u64,
    pub resamples: usize,
    pub methods: Vec<MethodScore>,
    /// Of every method against the one with the best average recall.
    pub differences: Vec<Difference>,
}

impl Comparison {
    /// From runs with their evaluations, in the order of the rows. The seed is that of the resampling.
    pub(crate) fn new(
        facts: &ListFacts,
        list: &TargetList,
        runs: &[(MethodRun, Evaluation)],
        seed: u64,
    ) -> Self {
        let methods: Vec<MethodScore> =
            runs.iter().map(|(run, evaluation)| score(run, evaluation, seed)).collect();
        let best = (0..runs.len()).max_by(|&a, &b| methods[a].ar.value.total_cmp(&methods[b].ar.value));
        let against = |best: usize| {
            let others = (0..runs.len()).filter(move |&i| i != best);
            others.map(move |other| Difference {
                a: methods_name(runs, best),
                b: methods_name(runs, other),
                ar: paired_difference(&runs[best].1.targets, &runs[other].1.targets, RESAMPLES, seed),
            })
        };
        Self {
            dataset: list.dataset.name(),
            facts: facts.clone(),
            skipped_detections: skipped_by_reason(list),
            overlaps: overlap_bins(&list.targets),
            targets: runs.first().map_or(0, |(_, evaluation)| evaluation.targets.len()),
            seed,
            resamples: RESAMPLES,
            differences: best.into_iter().flat_map(against).collect(),
            methods,
        }
    }
}

fn methods_name(runs: &[(MethodRun, Evaluation)], index: usize) -> String {
    runs[index].0.name.clone()
}

fn score(run: &MethodRun, evaluation: &Evaluation, seed: u64) -> MethodScore {
    let mut posed: BTreeMap<(u32, u32, u32), usize> = BTreeMap::new();
    for result in &run.poses.results {
        *posed.entry((result.scene_id, result.im_id, result.obj_id)).or_default() += 1;
    }
    let missing = evaluation.targets.iter().filter(|t| !posed.contains_key(&(t.scene_id, t.im_id, t.obj_id)));
    MethodScore {
        name: run.name.clone(),
        ar: average_recall_interval(&evaluation.targets, RESAMPLES, seed),
        targets_without_pose: missing.count(),
        pairs: run.poses.pairs,
        mean_time_per_pair_s: run.poses.mean_time_per_pair_s().unwrap_or(-1.0),
        rejections: run.poses.reasons(),
        scores: evaluation.scores.clone(),
    }
}
