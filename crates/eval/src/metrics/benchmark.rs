//! A target list from poses to scores, with the files that record it.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use unopose_dataset::{
    formats::{
        Target,
        files::write_json,
        results::{result_file_name, write_results},
        targets::{read_annotated_targets, read_targets},
    },
    protocol::{TargetList, TargetPoses},
};

use super::{
    EvalError,
    bins::RotationBins,
    options::ScoreOptions,
    scoring::{Evaluation, annotated, score_results},
};

/// The dataset's own list of targets.
const BOP_TARGETS: &str = "test_targets_bop19.json";

/// Writes `METHOD_DATASET-SPLIT.csv` and `rejected.json` into `folder`; returns the table's path.
pub fn write_poses(
    list: &TargetList,
    poses: &TargetPoses,
    method: &str,
    folder: &Path,
) -> Result<PathBuf, EvalError> {
    let path = folder.join(result_file_name(method, &list.dataset.name(), &list.split.name()));
    write_results(&path, &poses.results)?;
    write_json(&folder.join("rejected.json"), &poses.rejections, true)?;
    Ok(path)
}

/// Scores the poses of a target list. Recall counts the targets of `score_targets` when given, else those of the list
/// (with the number of instances that the dataset's own list gives them). [`EvalError::NoAnnotations`] where the true poses
/// are not known.
pub fn score_poses(
    list: &TargetList,
    poses: &TargetPoses,
    score_targets: Option<&Path>,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Evaluation, EvalError> {
    let targets = match score_targets {
        Some(path) => read_annotated_targets(path, &list.split)?,
        None => targets_of(list)?,
    };
    let targets = annotated(&list.split, targets)?;
    let rotations = RotationBins::new(&list.targets, &list.dataset, &list.split, list.reference_split())?;
    let options =
        ScoreOptions { rotations: Some(&rotations), progress, ..ScoreOptions::for_dataset(&list.dataset) };
    let mut evaluation = score_results(&list.dataset, &list.split, &targets, &poses.results, &options)?;
    // Measured, where the table only knows the images' times.
    evaluation.scores.mean_time_per_pair_s = poses.mean_time_per_pair_s().unwrap_or(-1.0);
    let input = &mut evaluation.scores.input;
    input.add_detections(&list.skipped, &list.ids);
    input.add_unread(&poses.unread);
    Ok(evaluation)
}

/// The list's targets, each once.
fn targets_of(list: &TargetList) -> Result<Vec<Target>, EvalError> {
    let own = list.dataset.file(BOP_TARGETS);
    let own = if own.is_file() { read_targets(&own)? } else { Vec::new() };
    let key = |t: &Target| (t.scene_id, t.im_id, t.obj_id);
    let counts: BTreeMap<_, u32> = own.iter().map(|t| (key(t), t.inst_count)).collect();
    let targets = list.targets.iter().map(|t| {
        let target = Target { scene_id: t.scene_id, im_id: t.im_id, obj_id: t.obj_id, inst_count: 1 };
        Target { inst_count: counts.get(&key(&target)).copied().unwrap_or(1), ..target }
    });
    let unique: BTreeMap<_, Target> = targets.map(|t| (key(&t), t)).collect();
    Ok(unique.into_values().collect())
}
