//! `unoinfer calibrate-proposals`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use unopose_cli::{DeviceOption, say};
use unopose_dataset::formats::files::write_json;
use unopose_nn::checkpoint::TensorFile;
use unopose_segment::{LearnedProposals, Objectness, ObservedMask, observe_masks};

use super::{options::SplitOptions, progress::ProgressDisplay};

#[derive(Args)]
pub struct CalibrateProposalsArguments {
    /// Checkpoint of unotrain proposals
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// New checkpoint with the fitted rank in its metadata and its weights in half precision
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
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
    file.write_half(&arguments.output)?;
    say!("{}", arguments.output.display());
    Ok(())
}
