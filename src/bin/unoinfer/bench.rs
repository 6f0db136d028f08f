//! `unoinfer bench`.

use std::path::PathBuf;

use clap::Args;
use unopose::{
    bench::{Comparison, Examples, run_method, write_report},
    device::DeviceChoice,
    eval::{score_poses, write_poses},
    infer::{PoseEstimator, Refinement, TargetFiles, TargetList},
    registration::{CLASSICAL_METHODS, PairEstimator, Refined, classical_method},
};

use super::progress::Progress;

/// Name of the network among the methods.
const NETWORK: &str = "unopose";

#[derive(Args)]
pub struct BenchArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id
    #[arg(long, value_name = "JSON")]
    targets: PathBuf,
    /// Detections: scene_id, image_id, category_id, bbox, score, time, segmentation
    #[arg(long, value_name = "JSON")]
    detections: PathBuf,
    /// Methods, separated by commas: aligncenter, fpfh-ransac, fpfh-mac, ppf, unopose; or all
    #[arg(long, value_delimiter = ',', default_value = "all")]
    methods: Vec<String>,
    /// Refinements after every method, separated by commas: none, icp, gicp (local, at most 30 mm and 15 degrees)
    #[arg(long, value_delimiter = ',', default_value = "none")]
    refine: Vec<Refinement>,
    /// Folder for the tables, the page and the results that a later call goes on from
    #[arg(long, value_name = "DIR", default_value = "bench")]
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
    /// Weights of the network [default: as for estimate]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Compute device of the network: auto, flex, ndarray, wgpu or cuda
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// Seed of the network's sampling and of the confidence intervals
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub fn run(arguments: &BenchArguments) -> anyhow::Result<()> {
    let list = TargetList::open(&TargetFiles {
        dataset: arguments.dataset.clone(),
        split: arguments.split.clone(),
        reference_split: arguments.reference_split.clone(),
        targets: arguments.targets.clone(),
        detections: arguments.detections.clone(),
        limit: arguments.limit,
    })?;
    let (mut runs, mut examples) = (Vec::new(), Vec::new());
    for estimator in estimators(arguments)? {
        for &refinement in &arguments.refine {
            let refined = Refined { estimator: estimator.as_ref(), refinement };
            let name = refined.name();
            eprintln!("{name}, {} targets", list.targets.len());
            let progress = Progress::new("estimating");
            let show = &mut |done, total| progress.set(done, total);
            let run = run_method(&list, &refined, &arguments.out.join("results"), show)?;
            progress.finish();
            write_poses(&list, &run.poses, &name, &arguments.out.join(&name))?;
            let progress = Progress::new("scoring");
            let show = |done, total| progress.set(done, total);
            let evaluation = score_poses(&list, &run.poses, arguments.score_targets.as_deref(), &show)?;
            progress.finish();
            evaluation.write(&arguments.out.join(&name))?;
            eprintln!(
                "AR {:.4}, {} of {} pairs computed now",
                evaluation.scores.recall.ar, run.computed, run.poses.pairs
            );
            examples.push(Examples::draw(&list, &run, &evaluation, &arguments.out)?);
            runs.push((run, evaluation));
        }
    }
    let comparison = Comparison::new(&list.dataset.name(), &runs, arguments.seed);
    write_report(&comparison, &examples, &arguments.out)?;
    print!("{}", std::fs::read_to_string(arguments.out.join("table.md"))?);
    println!("\n{}", arguments.out.join("index.html").display());
    Ok(())
}

fn estimators(arguments: &BenchArguments) -> anyhow::Result<Vec<Box<dyn PairEstimator>>> {
    let all = arguments.methods.iter().any(|name| name == "all");
    let names: Vec<&str> = if all {
        CLASSICAL_METHODS.into_iter().chain([NETWORK]).collect()
    } else {
        arguments.methods.iter().map(String::as_str).collect()
    };
    let mut estimators: Vec<Box<dyn PairEstimator>> = Vec::new();
    for name in names {
        estimators.push(if name == NETWORK {
            let estimator = match &arguments.checkpoint {
                Some(path) => PoseEstimator::load(path, arguments.device)?,
                None => PoseEstimator::load_default(arguments.device)?,
            };
            Box::new(estimator.with_seed(arguments.seed))
        } else {
            classical_method(name)?
        });
    }
    Ok(estimators)
}
