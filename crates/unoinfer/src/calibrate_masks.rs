//! `unoinfer calibrate-masks`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::Args;
use unopose_cli::{DeviceOption, say};
use unopose_dataset::formats::{files::write_json, targets::read_reference_targets};
use unopose_eval::report::{Curve, Panel, write_curves};
use unopose_infer::PoseEstimator;
use unopose_nn::checkpoint;
use unopose_segment::{GeometricMatcher, MatchScore, PresenceReport, RIGHT_IOU, observe_matches};

use super::{options::SplitOptions, progress::ProgressDisplay, proposals::ProposalOptions};

#[derive(Args)]
pub struct CalibrateMasksArguments {
    /// Checkpoint of unotrain; the fitted score is written into its metadata
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// New checkpoint instead of changing that one
    #[arg(long, value_name = "FILE", conflicts_with = "report")]
    output: Option<PathBuf>,
    /// Only measure the score that the checkpoint has
    #[arg(long)]
    report: bool,
    /// BOP dataset folder of synthetic images (unogen --format bop) of objects that were not trained on
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views [default: test_ref_targets_crossscene_rot50.json of the dataset]
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    /// Only the first N entries of the target list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    #[command(flatten)]
    splits: SplitOptions,
    #[command(flatten)]
    proposals: ProposalOptions,
    /// Folder for matches.json (every posed proposal with its evidence and truth), presence.json and presence.svg
    #[arg(long, value_name = "DIR", default_value = "calibration-masks")]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceOption,
}

pub fn run(arguments: &CalibrateMasksArguments) -> anyhow::Result<()> {
    let splits = arguments.splits.of(&arguments.dataset);
    let dataset = splits.open()?;
    let (split, references) = (splits.of_targets(&dataset)?, splits.of_references(&dataset)?);
    let list = "test_ref_targets_crossscene_rot50.json";
    let path = arguments.targets.clone().unwrap_or_else(|| arguments.dataset.join(list));
    let mut targets = read_reference_targets(&path)?;
    targets.truncate(arguments.limit.unwrap_or(usize::MAX).max(1));
    // Before the work: a file that cannot carry a score is refused.
    checkpoint::read_meta(&arguments.checkpoint)?;
    let estimator = PoseEstimator::load(&arguments.checkpoint, arguments.device.choice())?;
    let generator = arguments.proposals.generator(arguments.device.choice())?;
    let matcher = GeometricMatcher::new(&estimator)?;
    let progress = ProgressDisplay::new("searching");
    let observed = observe_matches(
        &matcher,
        generator.as_ref(),
        &targets,
        &split,
        references.as_ref().unwrap_or(&split),
        &mut |done, total| progress.set(done, total),
    )?;
    progress.finish();
    ensure!(!observed.is_empty(), "{}: no proposal in any image", arguments.dataset.display());
    write_json(&arguments.out.join("matches.json"), &observed, false)?;
    if arguments.report {
        let score = MatchScore::from_metadata(estimator.metadata(), &arguments.checkpoint)?;
        let score =
            score.with_context(|| format!("{} has no score of matches", arguments.checkpoint.display()))?;
        return write_report(&score.presence(&observed), &score, &arguments.out);
    }
    let right = observed.iter().filter(|o| o.iou >= RIGHT_IOU).count();
    let score = MatchScore::fit(&observed, &dataset.name()).with_context(|| {
        format!("{} proposals, {right} of them right: expected at least 20 of either kind", observed.len())
    })?;
    for (feature, weight) in &score.weights {
        say!("  {feature:?}: weight {weight:.3}");
    }
    write_report(&score.presence(&observed), &score, &arguments.out)?;
    let output = arguments.output.as_ref().unwrap_or(&arguments.checkpoint);
    checkpoint::annotate(&arguments.checkpoint, output, [score.to_metadata()])?;
    say!("{}", output.display());
    Ok(())
}

fn write_report(report: &PresenceReport, score: &MatchScore, out: &Path) -> anyhow::Result<()> {
    write_json(&out.join("presence.json"), report, true)?;
    let points = |column: usize| {
        let of = |(i, shares): (usize, &[f64; 2])| (i as f64 / 100.0, shares[column]);
        report.curve.iter().enumerate().map(of).collect()
    };
    let curve = |label: &str, points| Curve { label: label.into(), points, faint: false };
    let curves = vec![curve("found objects kept", points(0)), curve("absent objects reported", points(1))];
    let panel = Panel { title: "Objects that are reported".into(), curves, range: Some((0.0, 1.0)) };
    write_curves(&out.join("presence.svg"), "threshold", &[panel])?;
    say!(
        "of {} objects that are there {:.1} % are found; at the threshold {:.2}, {:.1} % of these are kept, and {:.1} % of {} \
         absent objects are reported",
        report.present,
        100.0 * report.found,
        score.threshold,
        100.0 * report.kept,
        100.0 * report.invented,
        report.absent
    );
    Ok(())
}
