//! `unoinfer analyse`.

use std::path::PathBuf;

use anyhow::ensure;
use clap::Args;
use unopose_bench::analysis::{analyse, judged, write_findings, write_reliability};
use unopose_cli::{print_text, say};
use unopose_dataset::protocol::{TargetFiles, TargetList};
use unopose_infer::PoseCriterion;

use super::{
    calibrate::describe,
    options::{EstimatorOptions, SplitOptions},
    progress::ProgressDisplay,
    score::print_unused,
};

#[derive(Args)]
pub struct AnalyseArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id
    #[arg(long, value_name = "JSON")]
    targets: PathBuf,
    /// Detections: scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(long, value_name = "JSON")]
    detections: PathBuf,
    /// Folder for findings.md, pairs.json and, with a calibration, reliability.svg and risk.svg
    #[arg(long, value_name = "DIR", default_value = "analysis")]
    out: PathBuf,
    #[command(flatten)]
    splits: SplitOptions,
    /// Only the first N entries of the target list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    #[command(flatten)]
    estimator: EstimatorOptions,
}

pub fn run(arguments: &AnalyseArguments) -> anyhow::Result<()> {
    let list = TargetList::open(&TargetFiles {
        splits: arguments.splits.of(&arguments.dataset),
        targets: arguments.targets.clone(),
        detections: arguments.detections.clone(),
        limit: arguments.limit,
    })?;
    print_unused(&list);
    let estimator = arguments.estimator.estimator()?;
    let progress = ProgressDisplay::new("analysing");
    let right = estimator.calibration().map_or(PoseCriterion::DEFAULT, |calibration| calibration.right);
    let records = analyse(&estimator, &list, right, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    ensure!(!records.is_empty(), "{}: no target could be analysed", arguments.dataset.display());
    let title = format!("{} on {}", estimator.source(), list.dataset.name());
    print_text(&write_findings(&records, &title, &arguments.out)?);
    if let Some(calibration) = estimator.calibration() {
        let reliability = write_reliability(&judged(&records, calibration), &arguments.out)?;
        say!("\nconfidence: {}", describe(&reliability));
    }
    say!("\n{}", arguments.out.join("findings.md").display());
    Ok(())
}
