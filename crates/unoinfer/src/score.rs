//! `unoinfer score`.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use clap::Args;
use serde::Serialize;
use unopose_cli::{say, tell};
use unopose_dataset::{
    formats::{detections::read_detections, files::write_json, targets::read_annotated_targets},
    protocol::{TargetList, UsableDetections},
};
use unopose_eval::metrics::{
    AverageRecall, CocoScores, Evaluation, InputReport, Interval, RegionKind, ScoreFiles,
    average_recall_interval, coco_scores, error_type_intervals, score_files,
};

use super::{options::SplitOptions, progress::ProgressDisplay};

#[derive(Args)]
pub struct ScoreArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Result table: scene_id,im_id,obj_id,score,R,t,time (its name does not matter)
    #[arg(long, value_name = "CSV", required_unless_present = "detections")]
    results: Option<PathBuf>,
    /// Detections to score as in COCO: scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(long, value_name = "JSON")]
    detections: Option<PathBuf>,
    /// Target list; one of images alone (BOP's of 2024) asks for every object that is annotated in them [default:
    /// test_targets_bop19.json of the dataset, else test_targets_bop24.json]
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    /// List of references for the rotation bins [default: the target list when it names references]
    #[arg(long, value_name = "JSON")]
    references: Option<PathBuf>,
    #[command(flatten)]
    splits: SplitOptions,
    /// Folder for scores.json and errors.json, and coco.json of detections
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub fn run(arguments: &ScoreArguments) -> anyhow::Result<()> {
    if let Some(results) = &arguments.results {
        poses(arguments, results)?;
    }
    if let Some(path) = &arguments.detections {
        detections(arguments, path)?;
    }
    Ok(())
}

fn poses(arguments: &ScoreArguments, results: &Path) -> anyhow::Result<()> {
    let files = ScoreFiles {
        splits: arguments.splits.of(&arguments.dataset),
        results: results.to_owned(),
        targets: arguments.targets.clone(),
        references: arguments.references.clone(),
    };
    let progress = ProgressDisplay::new("scoring");
    let evaluation = score_files(&files, &|done, total| progress.set(done, total))?;
    progress.finish();
    if let Some(folder) = &arguments.out {
        evaluation.write(folder)?;
    }
    print(&evaluation);
    print_warnings(&evaluation.scores.input);
    Ok(())
}

/// The detections of a list that are not used, on stderr: how many, and why.
pub fn print_unused(list: &TargetList) {
    for line in UsableDetections::messages(&list.skipped, &list.ids) {
        tell!("{line}");
    }
}

/// What makes the scores doubtful, on stderr.
pub fn print_warnings(input: &InputReport) {
    for warning in &input.warnings {
        tell!("WARNING: {warning}");
    }
}

/// Draws of the intervals, and their seed.
const RESAMPLES: (usize, u64) = (2000, 0);

/// mAP of the masks and of the boxes.
fn detections(arguments: &ScoreArguments, path: &Path) -> anyhow::Result<()> {
    let splits = arguments.splits.of(&arguments.dataset);
    let dataset = splits.open()?;
    let split = splits.of_targets(&dataset)?;
    let list = arguments.targets.clone().unwrap_or_else(|| dataset.targets_file());
    let targets = read_annotated_targets(&list, &split)?;
    let place = path.display().to_string();
    let ids: BTreeSet<[u32; 3]> = targets.iter().map(|t| [t.scene_id, t.im_id, t.obj_id]).collect();
    let detections = read_detections(path, Some(&split))?;
    let usable = UsableDetections::new(detections.clone(), &split, &ids);
    let unused = UsableDetections::messages(&usable.skipped, &usable.ids);
    let mut all = DetectionScores { input: InputReport::of_detections(&usable), ..Default::default() };
    for (name, kind) in [("segm", RegionKind::Mask), ("bbox", RegionKind::Box)] {
        let scores = coco_scores(&split, &targets, &detections, kind)?;
        say!(
            "{name}: mAP {:.4}, AP50 {:.4}, AP75 {:.4}, AR100 {:.4} ({} instances, {} ignored, {} of {} detections outside)",
            scores.map,
            scores.ap50,
            scores.ap75,
            scores.ar100,
            scores.n_instances,
            scores.n_ignored,
            scores.n_outside,
            detections.len()
        );
        all.kinds.insert(name, scores);
    }
    if let Some(folder) = &arguments.out {
        write_json(&folder.join("coco.json"), &all, true)?;
    }
    unused.iter().for_each(|line| tell!("{line}"));
    Ok(usable.require_any(&ids, &place)?)
}

/// What `coco.json` holds.
#[derive(Default, Serialize)]
struct DetectionScores {
    /// Of masks (`segm`) and boxes (`bbox`).
    #[serde(flatten)]
    kinds: BTreeMap<&'static str, CocoScores>,
    #[serde(flatten)]
    input: InputReport,
}

/// The scores as a table on stdout.
pub fn print(evaluation: &Evaluation) {
    let scores = &evaluation.scores;
    let line = |name: &str, recall: &AverageRecall| {
        let AverageRecall { ar, ar_vsd, ar_mssd, ar_mspd, n_targets } = recall;
        say!("{name:<16} {ar:>7.4} {ar_vsd:>7.4} {ar_mssd:>7.4} {ar_mspd:>7.4} {n_targets:>8}");
    };
    say!("{:<16} {:>7} {:>7} {:>7} {:>7} {:>8}", "", "AR", "VSD", "MSSD", "MSPD", "targets");
    line("all", &scores.recall);
    let (draws, seed) = RESAMPLES;
    let [vsd, mssd, mspd] = error_type_intervals(&evaluation.targets, draws, seed);
    let all = [average_recall_interval(&evaluation.targets, draws, seed), vsd, mssd, mspd];
    let ends = |name: &str, end: fn(&Interval) -> f64| {
        let [ar, vsd, mssd, mspd] = all.map(|interval| end(&interval));
        say!("{name:<16} {ar:>7.4} {vsd:>7.4} {mssd:>7.4} {mspd:>7.4}");
    };
    ends("95 % from", |interval| interval.low);
    ends("95 % to", |interval| interval.high);
    for (id, recall) in &scores.per_object {
        line(&format!("object {id}"), recall);
    }
    for (id, recall) in &scores.per_scene {
        line(&format!("scene {id}"), recall);
    }
    for (kind, print) in &scores.per_print {
        line(&format!("print: {kind}"), &print.recall);
    }
    for bin in &scores.per_visibility {
        line(&format!("visible {:.1}-{:.1}", bin.from, bin.to), &bin.recall);
    }
    for bin in &scores.per_rotation {
        line(&format!("{:.0}-{:.0} degrees", bin.from, bin.to), &bin.recall);
    }
    let (map, accuracy) = (&scores.detection, &scores.accuracy);
    say!("mAP {:.4} (MSSD {:.4}, MSPD {:.4})", map.map, map.map_mssd, map.map_mspd);
    say!(
        "AUC of ADD {:.4}, of ADD-S {:.4}; within 10 % of the diameter: ADD {:.4}, ADD-S {:.4}, ADD(-S) {:.4}",
        accuracy.add_auc,
        accuracy.add_s_auc,
        accuracy.add_01d,
        accuracy.add_s_01d,
        accuracy.add_or_add_s_01d
    );
    say!(
        "angular error {:.1} degrees, below 15 degrees {:.4}, below 30 degrees {:.4}",
        accuracy.angular_error_deg,
        accuracy.acc15,
        accuracy.acc30
    );
    if !scores.per_print.is_empty() {
        let shares = scores.per_print.iter().map(|(kind, print)| format!("{kind} {:.4}", print.acc15));
        say!("below 15 degrees by what the shape leaves open: {}", shares.collect::<Vec<_>>().join(", "));
    }
    if scores.n_strangers > 0 {
        say!("{} results are of images or objects that are no targets", scores.n_strangers);
    }
    if !scores.input.unread_images.is_empty() {
        say!("{} images could not be read", scores.input.unread_images.len());
    }
    for (what, seconds) in [("image", scores.mean_time_per_image_s), ("pair", scores.mean_time_per_pair_s)] {
        if seconds >= 0.0 {
            say!("{seconds:.3} s per {what}");
        } else {
            say!("time per {what} unknown");
        }
    }
}
