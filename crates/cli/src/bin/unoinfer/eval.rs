//! `unoinfer eval`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use unopose_dataset::protocol::{TargetFiles, TargetList};
use unopose_eval::eval::{score_poses, write_poses};
use unopose_infer::{
    Refinement, estimate_targets,
    experiment::{ReferenceColor, untrained},
};
use unopose_segment::AnyMatcher;

use super::{
    options::EstimatorOptions,
    progress::ProgressDisplay,
    proposals::ProposalOptions,
    score,
    segment_dataset::{DatasetFiles, segment_dataset},
};

/// Sources of masks.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Segmentation {
    Unoseg,
}

#[derive(Args)]
pub struct EvalArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id
    #[arg(long, value_name = "JSON")]
    targets: PathBuf,
    /// Detections: scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(
        long,
        value_name = "JSON",
        required_unless_present = "segmentation",
        conflicts_with = "ProposalOptions"
    )]
    detections: Option<PathBuf>,
    /// Where the masks come from instead of --detections: unoseg (--proposals, matched by --descriptor or the
    /// checkpoint); written to OUT/segmentation
    #[arg(long, conflicts_with = "detections")]
    segmentation: Option<Segmentation>,
    /// DINOv2 weights by which --segmentation compares proposals with the reference [default: the checkpoint compares]
    #[arg(long, value_name = "FILE", conflicts_with = "detections")]
    descriptor: Option<PathBuf>,
    #[command(flatten)]
    proposals: ProposalOptions,
    /// Folder for the result table, scores.json, errors.json and rejected.json
    #[arg(long, value_name = "DIR", default_value = "eval")]
    out: PathBuf,
    /// Split of the targets [default: test, or the first that begins so]
    #[arg(long)]
    split: Option<String>,
    /// Split of the reference views [default: that of the targets]
    #[arg(long)]
    reference_split: Option<String>,
    /// Targets that recall counts [default: those of --targets]
    #[arg(long, value_name = "JSON")]
    score_targets: Option<PathBuf>,
    /// Only the first N entries of the target list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// Colours of the references, to measure what they contribute: keep, gray or shuffled (in random places)
    #[arg(long, value_name = "COLORS", default_value = "keep")]
    reference_color: ReferenceColor,
    /// Draw the weights anew from the seed: what training has to beat
    #[arg(long)]
    untrained: bool,
    #[command(flatten)]
    estimator: EstimatorOptions,
}

pub fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let mut estimator = arguments.estimator.estimator()?;
    if arguments.untrained {
        let seed = estimator.seed();
        estimator = untrained(estimator, seed);
    }
    let detections = match &arguments.detections {
        Some(path) => path.clone(),
        None => {
            let files = DatasetFiles {
                dataset: arguments.dataset.clone(),
                split: arguments.split.clone(),
                reference_split: arguments.reference_split.clone(),
                targets: arguments.targets.clone(),
                limit: arguments.limit,
                templates: None,
            };
            let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
            let generator = arguments.proposals.generator(arguments.estimator.device())?;
            segment_dataset(&files, generator.as_ref(), &matcher, &arguments.out.join("segmentation"))?.0
        }
    };
    let list = TargetList::open(&TargetFiles {
        dataset: arguments.dataset.clone(),
        split: arguments.split.clone(),
        reference_split: arguments.reference_split.clone(),
        targets: arguments.targets.clone(),
        detections,
        limit: arguments.limit,
    })?;
    eprintln!("{} on {}, {} targets", estimator.source(), estimator.backend(), list.targets.len());
    let progress = ProgressDisplay::new("estimating");
    let poses = estimate_targets(&estimator, &list, arguments.reference_color, &mut |done, total| {
        progress.set(done, total)
    })?;
    progress.finish();
    let method = match estimator.refinement() {
        Refinement::None => "unopose".to_owned(),
        refinement => format!("unopose-{refinement}"),
    };
    let table = write_poses(&list, &poses, &method, &arguments.out)?;
    let progress = ProgressDisplay::new("scoring");
    let show = |done, total| progress.set(done, total);
    let evaluation = score_poses(&list, &poses, arguments.score_targets.as_deref(), &show)?;
    progress.finish();
    evaluation.write(&arguments.out)?;
    score::print(&evaluation);
    let (references, seconds) = (poses.references, poses.reference_seconds);
    println!(
        "{} pairs, {references} references ({:.3} s each, included above)",
        poses.pairs,
        seconds / references.max(1) as f64
    );
    if !poses.rejections.is_empty() {
        println!("{} without a pose:", poses.rejections.len());
        poses.reasons().iter().for_each(|(reason, count)| println!("  {count} x {reason}"));
    }
    println!("{} and {}", table.display(), arguments.out.join("scores.json").display());
    Ok(())
}
