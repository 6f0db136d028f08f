//! `unoinfer calibrate-proposals`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use unopose_cli::{DeviceOption, print_text, say};
use unopose_dataset::formats::{BopSplit, files::write_json};
use unopose_eval::report::Table;
use unopose_nn::checkpoint::TensorFile;
use unopose_segment::{
    LearnedProposals, Objectness, ObservedMask, ProposalGenerator, RegionProposals, observe_masks,
    proposal_scores,
};

use super::{options::SplitOptions, progress::ProgressDisplay};

#[derive(Args)]
pub struct CalibrateProposalsArguments {
    /// Checkpoint of unotrain proposals
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// New checkpoint with the fitted rank in its metadata and its weights in half precision
    #[arg(long, value_name = "FILE", required_unless_present = "report", conflicts_with = "report")]
    output: Option<PathBuf>,
    /// Only measure on the images: recall of the proposals without the network, of the network's and of both together
    #[arg(long, conflicts_with = "observed")]
    report: bool,
    /// BOP dataset folder of synthetic images (unogen --format bop, without distractors) of objects that were not trained on. A
    /// fifth of the images is only for judging the fit
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Only the first N images
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    #[command(flatten)]
    splits: SplitOptions,
    /// File for every candidate with its evidence and true overlap
    #[arg(long, value_name = "JSON")]
    observed: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceOption,
}

/// Every so many images one judges the fit.
const HELD_OUT: usize = 5;

pub fn run(arguments: &CalibrateProposalsArguments) -> anyhow::Result<()> {
    let splits = arguments.splits.of(&arguments.dataset);
    let dataset = splits.open()?;
    let split = splits.of_targets(&dataset)?;
    let Some(output) = &arguments.output else {
        return report(arguments, &split);
    };
    let device = arguments.device.choice().open()?.0;
    let proposals = LearnedProposals::load(&arguments.checkpoint, &device)?.with_regions();
    let progress = ProgressDisplay::new("proposing");
    let limit = arguments.limit.unwrap_or(usize::MAX);
    let observed = observe_masks(&proposals, &split, limit, &mut |done, total| progress.set(done, total))?;
    progress.finish();
    if let Some(path) = &arguments.observed {
        write_json(path, &observed, false)?;
    }
    let (judges, fitted): (Vec<ObservedMask>, Vec<ObservedMask>) =
        observed.iter().partition(|mask| mask.image % HELD_OUT == HELD_OUT - 1);
    let objectness = Objectness::fit(&fitted, &dataset.name()).with_context(|| {
        format!(
            "{}: {} candidate masks, expected at least 200 with evidence that differs",
            arguments.dataset.display(),
            fitted.len()
        )
    })?;
    for (name, masks) in [("fitted", &fitted), ("held out", &judges)] {
        let errors = masks.iter().map(|mask| (objectness.overlap(&mask.evidence) - mask.iou).abs());
        let mean = errors.sum::<f64>() / masks.len().max(1) as f64;
        say!("{name}: {} masks, mean error of the expected overlap {mean:.3}", masks.len());
    }
    let mut file = TensorFile::read(&arguments.checkpoint)?;
    file.metadata.extend([objectness.to_metadata()?]);
    file.write_half(output)?;
    say!("{}", output.display());
    Ok(())
}

fn report(arguments: &CalibrateProposalsArguments, split: &BopSplit) -> anyhow::Result<()> {
    let device = arguments.device.choice().open()?.0;
    let load = || LearnedProposals::load(&arguments.checkpoint, &device);
    let sources: [Box<dyn ProposalGenerator>; 3] =
        [Box::new(RegionProposals), Box::new(load()?), Box::new(load()?.with_regions())];
    let columns = [
        "proposals",
        "objects",
        "recall at 0.5",
        "at 0.75",
        "mean overlap",
        "first at 0.75",
        "per image",
        "s per image",
    ];
    let mut table = Table::new(columns);
    for source in &sources {
        let progress = ProgressDisplay::new("proposing");
        let limit = arguments.limit.unwrap_or(usize::MAX);
        let show = &mut |done, total| progress.set(done, total);
        let scores = proposal_scores(source.as_ref(), split, limit, show)?;
        progress.finish();
        table.push([
            scores.proposals.clone(),
            scores.objects.to_string(),
            format!("{:.3}", scores.recall_50),
            format!("{:.3}", scores.recall_75),
            format!("{:.3}", scores.mean_iou),
            format!("{:.3}", scores.first_75),
            format!("{:.1}", scores.per_image),
            format!("{:.3}", scores.seconds),
        ]);
    }
    print_text(&table.to_string());
    Ok(())
}
