//! `unoinfer calibrate`.

use std::path::PathBuf;

use anyhow::ensure;
use clap::Args;
use unopose_bench::analysis::{analyse, calibrate, judged, write_reliability};
use unopose_cli::{DeviceOption, say};
use unopose_dataset::protocol::{TargetFiles, TargetList};
use unopose_eval::metrics::Reliability;
use unopose_infer::{PoseCriterion, PoseEstimator};
use unopose_nn::checkpoint;

use super::{
    options::{HypothesisOptions, SplitOptions},
    progress::ProgressDisplay,
    score::print_unused,
};

#[derive(Args)]
pub struct CalibrateArguments {
    /// Checkpoint of unotrain; the calibration, and what `--set` changes, are written into its metadata
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// New checkpoint instead of changing that one
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// BOP dataset folder of synthetic images (unogen --format bop) of objects that were not trained on
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views [default: test_ref_targets_crossscene_rot90.json of the dataset]
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    /// Detections [default: dets_gt.json of the dataset]
    #[arg(long, value_name = "JSON")]
    detections: Option<PathBuf>,
    #[command(flatten)]
    splits: SplitOptions,
    /// Folder for reliability.svg, risk.svg and reliability.json of the pairs of the fit
    #[arg(long, value_name = "DIR", default_value = "calibration")]
    out: PathBuf,
    #[command(flatten)]
    hypotheses: HypothesisOptions,
    #[command(flatten)]
    device: DeviceOption,
}

pub fn run(arguments: &CalibrateArguments) -> anyhow::Result<()> {
    let file = |given: &Option<PathBuf>, name: &str| given.clone().unwrap_or(arguments.dataset.join(name));
    let list = TargetList::open(&TargetFiles {
        splits: arguments.splits.of(&arguments.dataset),
        targets: file(&arguments.targets, "test_ref_targets_crossscene_rot90.json"),
        detections: file(&arguments.detections, "dets_gt.json"),
        limit: None,
    })?;
    print_unused(&list);
    // Before the work: a file that cannot carry a calibration is refused.
    checkpoint::read_meta(&arguments.checkpoint)?;
    let mut config = checkpoint::read_config(&arguments.checkpoint)?;
    config.model.hypotheses = arguments.hypotheses.apply(&config.model)?;
    let estimator = PoseEstimator::load(&arguments.checkpoint, arguments.device.choice())?
        .with_hypotheses(config.model.hypotheses.clone());
    let progress = ProgressDisplay::new("calibrating");
    let right = PoseCriterion::DEFAULT;
    let records = analyse(&estimator, &list, right, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    ensure!(!records.is_empty(), "{}: no target has a pose", arguments.dataset.display());
    let calibration = calibrate(&records, right, &list.dataset.name())?;
    say!("right: {} of {} pairs", records.iter().filter(|r| r.right).count(), records.len());
    for term in calibration.terms.iter().filter(|term| term.weight > 0.0) {
        say!("  {:?}: weight {:.3}, usual {:.3}", term.feature, term.weight, term.usual);
    }
    say!("threshold: {:.2}", calibration.threshold);
    let reliability = write_reliability(&judged(&records, &calibration), &arguments.out)?;
    say!("on these pairs: {}", describe(&reliability));
    let output = arguments.output.as_ref().unwrap_or(&arguments.checkpoint);
    let entries = [calibration.to_metadata(), checkpoint::config_entry(&config)?];
    checkpoint::annotate(&arguments.checkpoint, output, entries)?;
    say!("{}", output.display());
    Ok(())
}

/// Reliability in a line.
pub fn describe(reliability: &Reliability) -> String {
    let auroc = reliability.auroc.map_or_else(|| "unknown".into(), |value| format!("{value:.3}"));
    format!(
        "{:.1} % of {} right, calibration error {:.3}, Brier score {:.3}, AUROC {auroc}; {:.1} % can be trusted with a \
         tenth of them wrong",
        100.0 * reliability.right_share,
        reliability.count,
        reliability.calibration_error,
        reliability.brier,
        100.0 * reliability.coverage_at_risk
    )
}
