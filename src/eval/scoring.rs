//! From result tables to scores.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use rayon::prelude::*;

use super::{
    EvalError, EvalObject, MeanTimes, PoseErrors, RotationBins, Scores, TargetOutcome, matching::top,
    outcome::hits, vsd::TestView,
};
use crate::formats::{
    BopDataset, BopScene, BopSplit, PoseResult, Target,
    files::write_json,
    results::read_results,
    targets::{read_reference_targets, read_targets},
};

/// Scores of a set of results, with the outcome of every target in the order of the targets.
#[derive(Clone, Debug)]
pub struct Evaluation {
    pub scores: Scores,
    pub targets: Vec<TargetOutcome>,
}

impl Evaluation {
    /// Writes `scores.json` and, target by target, `errors.json` into a folder.
    pub fn write(&self, folder: &Path) -> Result<(), EvalError> {
        self.scores.write(&folder.join("scores.json"))?;
        Ok(write_json(&folder.join("errors.json"), &self.targets, true)?)
    }
}

/// What scoring leaves open.
#[derive(Clone, Copy)]
pub struct ScoreOptions<'a> {
    /// VSD's tolerance of visibility, metres.
    pub delta: f64,
    /// Rotations between target and reference views, for the bins.
    pub rotations: Option<&'a RotationBins>,
    /// Called after every image with the numbers of images done (not in order) and of all images.
    pub progress: &'a (dyn Fn(usize, usize) + Sync),
}

impl ScoreOptions<'_> {
    /// BOP's parameters for a dataset: 15 mm, 5 mm for ITODD.
    pub fn for_dataset(dataset: &BopDataset) -> Self {
        let delta = if dataset.name().eq_ignore_ascii_case("itodd") { 0.005 } else { 0.015 };
        Self { delta, rotations: None, progress: &|_, _| {} }
    }
}

/// Files of [`score_files`].
#[derive(Clone, Debug)]
pub struct ScoreFiles {
    /// BOP dataset folder.
    pub dataset: PathBuf,
    /// Result table; its name does not matter.
    pub results: PathBuf,
    /// Split of the targets; found when `None`.
    pub split: Option<String>,
    /// Targets or references list; `test_targets_bop19.json` of the dataset when `None`.
    pub targets: Option<PathBuf>,
    /// References list for the rotation bins; `targets` when that is one.
    pub references: Option<PathBuf>,
    /// Split of the references; that of the targets when `None`.
    pub reference_split: Option<String>,
}

/// Scores a result table.
pub fn score_files(
    files: &ScoreFiles,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Evaluation, EvalError> {
    let dataset = BopDataset::open(&files.dataset)?;
    let split = match &files.split {
        Some(name) => dataset.split(name)?,
        None => dataset.test_split()?,
    };
    let targets_path = files.targets.clone().unwrap_or_else(|| dataset.file("test_targets_bop19.json"));
    let targets = read_targets(&targets_path)?;
    let results = read_results(&files.results)?;
    let references = match &files.references {
        Some(path) => Some(read_reference_targets(path)?),
        None => read_reference_targets(&targets_path).ok(),
    };
    let rotations = match references {
        Some(references) => {
            let other_split = files.reference_split.as_ref().map(|name| dataset.split(name)).transpose()?;
            Some(RotationBins::new(&references, &dataset, &split, other_split.as_ref().unwrap_or(&split))?)
        }
        None => None,
    };
    let options =
        ScoreOptions { rotations: rotations.as_ref(), progress, ..ScoreOptions::for_dataset(&dataset) };
    score_results(&dataset, &split, &targets, &results, &options)
}

/// Scores results. Results of objects or images that are no targets are left out.
pub fn score_results(
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
    let mut by_target: BTreeMap<(u32, u32, u32), Vec<&PoseResult>> = BTreeMap::new();
    for result in results {
        by_target.entry((result.scene_id, result.im_id, result.obj_id)).or_default().push(result);
    }
    let is_target: BTreeSet<_> = targets.iter().map(|t| (t.scene_id, t.im_id, t.obj_id)).collect();
    let mut images: BTreeMap<(u32, u32), Vec<&Target>> = BTreeMap::new();
    for target in targets {
        images.entry((target.scene_id, target.im_id)).or_default().push(target);
    }
    let images: Vec<_> = images.into_iter().collect();
    let strangers = results.iter().filter(|r| !is_target.contains(&(r.scene_id, r.im_id, r.obj_id))).count();
    if strangers > 0 {
        tracing::warn!(
            "{strangers} of {} results are of images or objects that are no targets",
            results.len()
        );
    }
    let done = std::sync::atomic::AtomicUsize::new(0);
    let scored: Vec<ScoredImage> = images
        .par_iter()
        .map(|((scene_id, im_id), targets)| {
            let scene = split.scene(*scene_id)?;
            let image = score_image(&scene, *im_id, targets, &by_target, &objects, options)?;
            let count = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            (options.progress)(count, images.len());
            Ok(image)
        })
        .collect::<Result<_, EvalError>>()?;
    let n_estimates = scored.iter().map(|image| image.n_estimates).sum();
    let targets: Vec<TargetOutcome> = scored.into_iter().flat_map(|image| image.targets).collect();
    let scores = Scores::new(&targets, n_estimates, mean_times(results));
    Ok(Evaluation { scores, targets })
}

struct ScoredImage {
    targets: Vec<TargetOutcome>,
    n_estimates: usize,
}

fn score_image(
    scene: &BopScene,
    im_id: u32,
    targets: &[&Target],
    results: &BTreeMap<(u32, u32, u32), Vec<&PoseResult>>,
    objects: &BTreeMap<u32, EvalObject>,
    options: &ScoreOptions,
) -> Result<ScoredImage, EvalError> {
    let (depth, camera) = (scene.depth(im_id)?, scene.camera(im_id)?.intrinsics);
    let view = TestView { depth: &depth, camera: &camera, delta: options.delta };
    let (gt, info) = (scene.gt(im_id)?, scene.gt_info(im_id)?);
    let mut image = ScoredImage { targets: Vec::new(), n_estimates: 0 };
    for &&Target { scene_id, obj_id, inst_count, .. } in targets {
        let of_object: Vec<usize> = (0..gt.len()).filter(|&i| gt[i].obj_id == obj_id).collect();
        let (Some(object), false) = (objects.get(&obj_id), of_object.is_empty()) else {
            let scene = scene.folder.display().to_string();
            return Err(EvalError::TargetWithoutGt { scene, im_id, obj_id });
        };
        let visible = top(of_object.iter().map(|&i| info[i].visib_fract), inst_count as usize);
        let valid: Vec<usize> = visible.into_iter().map(|i| of_object[i]).collect();
        let estimates = results.get(&(scene_id, im_id, obj_id)).map_or(&[][..], Vec::as_slice);
        let best = top(estimates.iter().map(|e| e.score), inst_count as usize);

        let place = format!("{}: image {im_id}", scene.folder.join("scene_gt.json").display());
        let truths = valid.iter().map(|&i| gt[i].pose(&place)).collect::<Result<Vec<_>, _>>()?;
        let seen = if best.is_empty() { &[][..] } else { &truths[..] };
        let rendered: Vec<_> = seen.iter().map(|t_gt| view.render(object, t_gt)).collect();
        let errors: Vec<Vec<PoseErrors>> = best
            .iter()
            .map(|&e| {
                let t_est = &estimates[e].t_camera_object;
                let pairs = truths.iter().zip(&rendered);
                pairs.map(|(t_gt, window)| PoseErrors::new(object, &view, t_est, t_gt, window)).collect()
            })
            .collect();
        image.n_estimates += best.len();
        let hits = hits(&errors, valid.len(), object.diameter, depth.width);
        for (position, (&gt_index, hits)) in valid.iter().zip(hits).enumerate() {
            let order = |e: &PoseErrors| (e.mssd, e.vsd.iter().sum::<f64>());
            let candidates = errors.iter().map(|row| &row[position]);
            let closest = candidates.min_by(|a, b| {
                let ((a, a_vsd), (b, b_vsd)) = (order(a), order(b));
                a.total_cmp(&b).then(a_vsd.total_cmp(&b_vsd))
            });
            image.targets.push(TargetOutcome {
                scene_id,
                im_id,
                obj_id,
                gt_index,
                visib_fract: info[gt_index].visib_fract,
                rot_deg: options.rotations.and_then(|r| r.degrees(scene_id, im_id, obj_id)),
                errors: closest.cloned(),
                hits,
            });
        }
    }
    Ok(image)
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
