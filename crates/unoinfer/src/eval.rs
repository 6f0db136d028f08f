//! `unoinfer eval`.

use std::path::PathBuf;

use anyhow::{Context, bail, ensure};
use clap::Args;
use unopose_bench::{DetectionSource, ListRequest};
use unopose_cli::{say, tell};
use unopose_dataset::protocol::{TargetFiles, TargetList};
use unopose_eval::metrics::{EvalError, score_poses, write_poses};
use unopose_infer::{
    PoseEstimator, Refinement, estimate_targets,
    experiment::{ReferenceColor, untrained},
};
use unopose_segment::AnyMatcher;

use super::{
    options::{EstimatorOptions, SplitOptions},
    progress::ProgressDisplay,
    proposals::{FOR_UNOSEG, ProposalOptions},
    score,
    segment_dataset::{DatasetFiles, NOT_SCORED, segment_dataset},
};

#[derive(Args)]
pub struct EvalArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id
    #[arg(long, value_name = "JSON")]
    targets: PathBuf,
    /// Masks: gt (annotated visible masks), unoseg (found as `segment` does, by --descriptor or the checkpoint; kept in
    /// OUT/segmentation), or a file with scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(long, value_name = "gt|unoseg|JSON")]
    detections: DetectionSource,
    /// DINOv2 weights by which unoseg compares proposals with the reference [default: the checkpoint compares]
    #[arg(long, value_name = "FILE")]
    descriptor: Option<PathBuf>,
    #[command(flatten)]
    proposals: ProposalOptions,
    /// Folder for the result table, scores.json, errors.json and rejected.json
    #[arg(long, value_name = "DIR", default_value = "eval")]
    out: PathBuf,
    #[command(flatten)]
    splits: SplitOptions,
    /// Targets that recall counts [default: those of --targets]
    #[arg(long, value_name = "JSON")]
    score_targets: Option<PathBuf>,
    /// Only the first N entries of the target list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// Colours of the references, to measure what colour contributes: keep, gray or shuffled (pixels in random order)
    #[arg(long, value_name = "COLORS", default_value = "keep")]
    reference_color: ReferenceColor,
    /// Random weights from the seed instead of the checkpoint's: the baseline of training
    #[arg(long)]
    untrained: bool,
    #[command(flatten)]
    estimator: EstimatorOptions,
}

pub fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let of_unoseg = arguments.descriptor.is_some() || arguments.proposals.are_given();
    if of_unoseg && arguments.detections != DetectionSource::UnoSeg(()) {
        bail!(FOR_UNOSEG);
    }
    let mut estimator = arguments.estimator.estimator()?;
    if arguments.untrained {
        let seed = estimator.seed();
        estimator = untrained(estimator, seed);
    }
    let list = target_list(arguments, &estimator)?;
    tell!("{} on {}, {} targets", estimator.source(), estimator.backend(), list.targets.len());
    score::print_unused(&list);
    let progress = ProgressDisplay::new("estimating");
    let poses = estimate_targets(&estimator, &list, arguments.reference_color, &mut |done, total| {
        progress.set(done, total)
    });
    progress.finish();
    let method = match estimator.refinement() {
        Refinement::None => "unopose".to_owned(),
        refinement => format!("unopose-{refinement}"),
    };
    let table = write_poses(&list, &poses, &method, &arguments.out)?;
    let progress = ProgressDisplay::new("scoring");
    let show = |done, total| progress.set(done, total);
    let evaluation = match score_poses(&list, &poses, arguments.score_targets.as_deref(), &show) {
        Err(EvalError::NoAnnotations { .. }) => None,
        scored => Some(scored?),
    };
    progress.finish();
    match &evaluation {
        Some(evaluation) => {
            evaluation.write(&arguments.out)?;
            score::print(evaluation);
        }
        None => say!("{NOT_SCORED}"),
    }
    let (references, seconds) = (poses.references, poses.reference_seconds);
    say!(
        "{} pairs, {references} references ({:.3} s each, included above)",
        poses.pairs,
        seconds / references.max(1) as f64
    );
    if !poses.rejections.is_empty() {
        say!("{} without a pose:", poses.rejections.len());
        poses.reasons().iter().for_each(|(reason, count)| say!("  {count} x {reason}"));
    }
    match evaluation {
        Some(evaluation) => {
            say!("{} and {}", table.display(), arguments.out.join("scores.json").display());
            score::print_warnings(&evaluation.scores.input);
        }
        None => say!("{}", table.display()),
    }
    ensure!(!poses.results.is_empty(), "none of {} targets got a pose", list.targets.len());
    Ok(())
}

/// The targets with detections from the source that is asked for.
fn target_list(arguments: &EvalArguments, estimator: &PoseEstimator) -> anyhow::Result<TargetList> {
    let detections = match &arguments.detections {
        DetectionSource::GroundTruth => return annotated_list(arguments),
        DetectionSource::File(path) => path.clone(),
        DetectionSource::UnoSeg(()) => {
            let files = DatasetFiles {
                splits: arguments.splits.of(&arguments.dataset),
                targets: arguments.targets.clone(),
                limit: arguments.limit,
                templates: None,
            };
            let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), estimator)?;
            let generator = arguments.proposals.generator(arguments.estimator.device())?;
            segment_dataset(&files, generator.as_ref(), &matcher, &arguments.out.join("segmentation"))?.0
        }
    };
    Ok(TargetList::open(&TargetFiles {
        splits: arguments.splits.of(&arguments.dataset),
        targets: arguments.targets.clone(),
        detections,
        limit: arguments.limit,
    })?)
}

/// The targets with their annotated visible masks, as the benchmark takes them.
fn annotated_list(arguments: &EvalArguments) -> anyhow::Result<TargetList> {
    // Without a name the references come from the targets' split; the benchmark has another default.
    let mut splits = arguments.splits.of(&arguments.dataset);
    if splits.reference_split.is_none() {
        splits.reference_split = Some(splits.of_targets(&splits.open()?)?.name());
    }
    let request = ListRequest {
        splits,
        targets: Some(arguments.targets.clone()),
        detections: DetectionSource::GroundTruth,
        limit: arguments.limit,
        seed: 0,
        rendered: false,
    };
    let prepared = request.prepare(&[], &arguments.out)?.pop().context("no targets")?;
    Ok(prepared.list)
}
