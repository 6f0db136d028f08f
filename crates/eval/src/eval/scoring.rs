//! From result tables to scores.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use unopose_dataset::formats::{
    BopDataset, BopSplit, DatasetSplits, PoseResult, Target,
    files::write_json,
    results::read_results,
    targets::{read_annotated_targets, read_reference_targets},
};

use super::{
    EvalError, EvalObject, PoseAveragePrecision, Scores, TargetOutcome,
    bins::RotationBins,
    options::ScoreOptions,
    scored_image::{Image, ScoredImage},
    scores::{EstimateCounts, MeanTimes},
};

/// Scores of a set of results, with the outcome of every target in the order of the targets.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Recalls, accuracies and times over all targets.
    pub scores: Scores,
    /// One outcome per target instance.
    pub targets: Vec<TargetOutcome>,
}

impl Evaluation {
    /// Writes `scores.json` and, target by target, `errors.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<(), EvalError> {
        self.scores.write(&folder.join("scores.json"))?;
        Ok(write_json(&folder.join("errors.json"), &self.targets, true)?)
    }
}

/// Files of [`score_files`].
#[derive(Clone, Debug)]
pub struct ScoreFiles {
    /// Dataset and splits.
    pub splits: DatasetSplits,
    /// Result table; its name does not matter.
    pub results: PathBuf,
    /// List of targets, images or references; `test_targets_bop19.json` of the dataset, else its `test_targets_bop24.json`
    /// when `None`.
    pub targets: Option<PathBuf>,
    /// References list for the rotation bins; `targets` when that is one.
    pub references: Option<PathBuf>,
}

/// Scores a result table.
pub fn score_files(
    files: &ScoreFiles,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Evaluation, EvalError> {
    let dataset = files.splits.open()?;
    let split = files.splits.of_targets(&dataset)?;
    let targets_path = files.targets.clone().unwrap_or_else(|| dataset.targets_file());
    let targets = annotated(&split, read_annotated_targets(&targets_path, &split)?)?;
    let results = read_results(&files.results)?;
    let references = match &files.references {
        Some(path) => Some(read_reference_targets(path)?),
        None => read_reference_targets(&targets_path).ok(),
    };
    let rotations = match references {
        Some(references) => {
            let other_split = files.splits.of_references(&dataset)?;
            Some(RotationBins::new(&references, &dataset, &split, other_split.as_ref().unwrap_or(&split))?)
        }
        None => None,
    };
    let options =
        ScoreOptions { rotations: rotations.as_ref(), progress, ..ScoreOptions::for_dataset(&dataset) };
    score_results(&dataset, &split, &targets, &results, &options)
}

/// The targets in images with an annotation; how many have none is told in the log. An error when none is left.
pub(super) fn annotated(split: &BopSplit, targets: Vec<Target>) -> Result<Vec<Target>, EvalError> {
    let (mut kept, mut hidden, mut file) = (Vec::new(), 0, None);
    for target in targets {
        let scene = split.scene(target.scene_id)?;
        if scene.is_annotated(target.im_id) {
            kept.push(target);
        } else {
            hidden += 1;
            file.get_or_insert_with(|| scene.gt_file().display().to_string());
        }
    }
    match file {
        Some(file) if kept.is_empty() => return Err(EvalError::NoAnnotations { file }),
        Some(file) => tracing::warn!("{hidden} targets have no annotation, as in {file}: they do not count"),
        None => {}
    }
    Ok(kept)
}

/// Scores results in memory. Average recalls leave out results of objects or images that are no targets.
pub(super) fn score_results(
    dataset: &BopDataset,
    split: &BopSplit,
    targets: &[Target],
    results: &[PoseResult],
    options: &ScoreOptions,
) -> Result<Evaluation, EvalError> {
    if targets.is_empty() {
        return Err(EvalError::NoTargets);
    }
    let objects = EvalObject::load_all(dataset, targets.iter().map(|t| t.obj_id).collect::<BTreeSet<_>>())?;
    let is_target: BTreeSet<_> = targets.iter().map(|t| (t.scene_id, t.im_id, t.obj_id)).collect();
    let mut images: BTreeMap<(u32, u32), Image> = BTreeMap::new();
    for target in targets {
        images.entry((target.scene_id, target.im_id)).or_default().targets.push(target);
    }
    let mut strangers = 0;
    for result in results {
        strangers += usize::from(!is_target.contains(&(result.scene_id, result.im_id, result.obj_id)));
        if let Some(image) = images.get_mut(&(result.scene_id, result.im_id)) {
            image.results.push(result);
        }
    }
    let images: Vec<_> = images.into_iter().collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let scored: Vec<ScoredImage> = images
        .par_iter()
        .map(|((scene_id, im_id), image)| {
            let scene = split.scene(*scene_id)?;
            let scored = image.score(&scene, *im_id, &objects, options)?;
            let count = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            (options.progress)(count, images.len());
            Ok(scored)
        })
        .collect::<Result<_, EvalError>>()?;
    let counts = EstimateCounts { compared: scored.iter().map(|i| i.n_estimates).sum(), strangers };
    let (targets, ranked): (Vec<_>, Vec<_>) = scored.into_iter().map(|i| (i.targets, i.ranked)).unzip();
    let (targets, ranked) = (targets.concat(), ranked.concat());
    let scores = Scores::new(&targets, PoseAveragePrecision::new(&ranked), counts, mean_times(results));
    Ok(Evaluation { scores, targets })
}

/// Every line of an image repeats the image's time; a negative one makes the mean unknown.
fn mean_times(results: &[PoseResult]) -> MeanTimes {
    let mut images: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for result in results {
        images.insert((result.scene_id, result.im_id), result.time);
    }
    if images.is_empty() || results.iter().any(|r| r.time < 0.0) {
        return MeanTimes { per_image_s: -1.0, per_pair_s: -1.0 };
    }
    let total: f64 = images.values().sum();
    MeanTimes { per_image_s: total / images.len() as f64, per_pair_s: total / results.len() as f64 }
}
