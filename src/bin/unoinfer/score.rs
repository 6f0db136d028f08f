//! `unoinfer score`.

use std::path::PathBuf;

use clap::Args;
use unopose::eval::{
    AverageRecall, Evaluation, Interval, ScoreFiles, average_recall_interval, error_type_intervals,
    score_files,
};

use super::progress::Progress;

#[derive(Args)]
pub struct ScoreArguments {
    /// BOP dataset folder
    #[arg(long, value_name = "DIR")]
    dataset: PathBuf,
    /// Result table: scene_id,im_id,obj_id,score,R,t,time (its name does not matter)
    #[arg(long, value_name = "CSV")]
    results: PathBuf,
    /// Target list [default: test_targets_bop19.json of the dataset]
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    /// List of references for the rotation bins [default: the target list when it names references]
    #[arg(long, value_name = "JSON")]
    references: Option<PathBuf>,
    /// Split of the targets [default: test, or the first that begins so]
    #[arg(long)]
    split: Option<String>,
    /// Split of the reference views [default: that of the targets]
    #[arg(long)]
    reference_split: Option<String>,
    /// Folder for scores.json and errors.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub fn run(arguments: &ScoreArguments) -> anyhow::Result<()> {
    let files = ScoreFiles {
        dataset: arguments.dataset.clone(),
        results: arguments.results.clone(),
        split: arguments.split.clone(),
        targets: arguments.targets.clone(),
        references: arguments.references.clone(),
        reference_split: arguments.reference_split.clone(),
    };
    let progress = Progress::new("scoring");
    let evaluation = score_files(&files, &|done, total| progress.set(done, total))?;
    progress.finish();
    if let Some(folder) = &arguments.out {
        evaluation.write(folder)?;
    }
    print(&evaluation);
    Ok(())
}

/// Draws of the intervals, and their seed.
const RESAMPLES: (usize, u64) = (2000, 0);

/// The scores as a table on stdout.
pub fn print(evaluation: &Evaluation) {
    let scores = &evaluation.scores;
    let line = |name: &str, recall: &AverageRecall| {
        let AverageRecall { ar, ar_vsd, ar_mssd, ar_mspd, n_targets } = recall;
        println!("{name:<16} {ar:>7.4} {ar_vsd:>7.4} {ar_mssd:>7.4} {ar_mspd:>7.4} {n_targets:>8}");
    };
    println!("{:<16} {:>7} {:>7} {:>7} {:>7} {:>8}", "", "AR", "VSD", "MSSD", "MSPD", "targets");
    line("all", &scores.recall);
    let (draws, seed) = RESAMPLES;
    let [vsd, mssd, mspd] = error_type_intervals(&evaluation.targets, draws, seed);
    let all = [average_recall_interval(&evaluation.targets, draws, seed), vsd, mssd, mspd];
    let ends = |name: &str, end: fn(&Interval) -> f64| {
        let [ar, vsd, mssd, mspd] = all.map(|interval| end(&interval));
        println!("{name:<16} {ar:>7.4} {vsd:>7.4} {mssd:>7.4} {mspd:>7.4}");
    };
    ends("95 % from", |interval| interval.low);
    ends("95 % to", |interval| interval.high);
    for (id, recall) in &scores.per_object {
        line(&format!("object {id}"), recall);
    }
    for bin in &scores.per_visibility {
        line(&format!("visible {:.1}-{:.1}", bin.from, bin.to), &bin.recall);
    }
    for bin in &scores.per_rotation {
        line(&format!("{:.0}-{:.0} degrees", bin.from, bin.to), &bin.recall);
    }
    for (what, seconds) in [("image", scores.mean_time_per_image_s), ("pair", scores.mean_time_per_pair_s)] {
        if seconds >= 0.0 {
            println!("{seconds:.3} s per {what}");
        } else {
            println!("time per {what} unknown");
        }
    }
}
