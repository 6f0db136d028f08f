//! From result tables to scores.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use unopose_dataset::{
    formats::{
        BopDataset, BopSplit, DatasetSplits, PoseResult, Target,
        files::write_json,
        results::read_results,
        targets::{read_annotated_targets, read_reference_targets},
        units,
    },
    protocol::{IdMatch, UnreadImages},
};

use super::{
    EvalError, EvalObject, PoseAveragePrecision, Scores, TargetOutcome,
    bins::RotationBins,
    input_report::model_problems,
    options::ScoreOptions,
    prints::per_print,
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

/// Scores a result table. An error when none of its poses belongs to a target.
pub fn score_files(
    files: &ScoreFiles,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Evaluation, EvalError> {
    let dataset = files.splits.open()?;
    let split = files.splits.of_targets(&dataset)?;
    let targets_path = files.targets.clone().unwrap_or_else(|| dataset.targets_file());
    let targets = annotated(&split, read_annotated_targets(&targets_path, &split)?)?;
    let results = read_results(&files.results)?;
    let ids = result_ids(&targets, &results);
    if let (true, Some(problem)) = (ids.unmatched == ids.entries, ids.message("results")) {
        return Err(EvalError::NoResultOfTargets { file: files.results.display().to_string(), problem });
    }
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
    let mut images: BTreeMap<(u32, u32), Image> = BTreeMap::new();
    for target in targets {
        images.entry((target.scene_id, target.im_id)).or_default().targets.push(target);
    }
    for result in results {
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
            let scored = match image.score(&scene, *im_id, &objects, options) {
                // Annotation that cannot be read costs the image: its targets are not known.
                Err(EvalError::Format(error)) => {
                    let mut scored = ScoredImage::default();
                    scored.unread.add(*scene_id, *im_id, &error);
                    scored
                }
                scored => scored?,
            };
            let count = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            (options.progress)(count, images.len());
            Ok(scored)
        })
        .collect::<Result<_, EvalError>>()?;
    let ids = result_ids(targets, results);
    let counts =
        EstimateCounts { compared: scored.iter().map(|i| i.n_estimates).sum(), strangers: ids.unmatched };
    let mut unread = UnreadImages::default();
    scored.iter().for_each(|image| unread.merge(&image.unread));
    if unread.len() == images.len() {
        let first = unread.by_cause().swap_remove(0);
        return Err(EvalError::NothingRead { images: images.len(), first });
    }
    let mut warnings = model_problems(&objects, &dataset.models_info_place());
    warnings.extend(ids.is_suspicious().then(|| ids.message("results")).flatten());
    warnings.extend(pose_problems(&scored, results));
    let (targets, ranked): (Vec<_>, Vec<_>) = scored.into_iter().map(|i| (i.targets, i.ranked)).unzip();
    let (targets, ranked) = (targets.concat(), ranked.concat());
    let mut scores = Scores::new(&targets, PoseAveragePrecision::new(&ranked), counts, mean_times(results));
    scores.per_print = per_print(dataset, &targets)?;
    scores.input.warnings = warnings;
    scores.input.add_unread(&unread);
    Ok(Evaluation { scores, targets })
}

/// The ids of the results against those of the targets.
fn result_ids(targets: &[Target], results: &[PoseResult]) -> IdMatch {
    let results: Vec<_> = results.iter().map(|r| [r.scene_id, r.im_id, r.obj_id]).collect();
    IdMatch::new(&results, &targets.iter().map(|t| [t.scene_id, t.im_id, t.obj_id]).collect())
}

/// Units that the distances of poses and the measured depth give away.
fn pose_problems(scored: &[ScoredImage], results: &[PoseResult]) -> Vec<String> {
    let mut annotated: Vec<f64> = scored.iter().flat_map(|image| image.distances.iter().copied()).collect();
    let mut table: Vec<f64> = results.iter().map(|r| r.t_camera_object.translation.norm()).collect();
    let mut problems = units::table_problems(&mut table, &mut annotated);
    let depth = |which: usize| -> Vec<f64> {
        scored.iter().flat_map(|image| image.depths.iter().map(|depths| depths[which])).collect()
    };
    problems.extend(units::depth_problem(&mut depth(0), &mut depth(1)));
    problems
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
