//! Trains UNOPose: `unotrain --config configs/geo.toml`.

mod progress;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use anyhow::Context as _;
use clap::{Args, Parser, Subcommand};
use unopose_cli::{DeviceOption, print_text, say, tell};
use unopose_core::{
    config::{Config, MAX_THREADS},
    explain,
    interrupt::Interrupt,
};
use unopose_eval::report::Table;
use unopose_nn::device::keep_freed_memory;
use unopose_train::{
    StopReason, TrainOptions, TrainOutcome, ValidationRecord, distil, train, train_proposals,
};

use progress::ProgressBars;

/// Train UNOPose. Without data it generates its synthetic training and validation sets first; an interrupted run
/// resumes.
///
/// Ctrl-C, SIGTERM and SIGHUP save and stop. Exit codes: 0 done, or stopped by --minutes or --stop-at; 1 failed; 2 wrong
/// arguments; 4 stopped before that, to be resumed with the same command.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: RunArguments,
}

#[derive(Subcommand)]
enum Command {
    /// Train the colour encoder alone: it learns the features of a DINOv2 backbone and which points of two views are the same.
    /// `model.color.weights` of a pose network takes the result.
    Distil {
        #[command(flatten)]
        run: RunArguments,
        /// DINOv2 weights: safetensors or PyTorch, in the naming of Meta, timm or Hugging Face.
        #[arg(long, value_name = "FILE")]
        teacher: PathBuf,
    },
    /// Train the network that proposes masks of unknown objects (`unoinfer --proposals learned`).
    Proposals {
        #[command(flatten)]
        run: RunArguments,
    },
}

/// What is trained.
enum Kind {
    Pose,
    /// With the teacher's weights.
    Encoder(PathBuf),
    Proposals,
}

/// Arguments of every kind of training.
#[derive(Args)]
struct RunArguments {
    /// Configuration file, or the name of a built-in one: geo, unopose, distil, proposals, smoke [default: geo; with `distil` and
    /// `proposals` the one of that name].
    #[arg(long)]
    config: Option<PathBuf>,
    /// Change a configuration value, for example `--set train.steps=2000`. Repeatable.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    /// Print the configuration with all defaults and changes as TOML, a comment with meaning, unit, allowed values and
    /// default before every key, and exit.
    #[arg(long)]
    print_config: bool,
    /// Run folder [default: runs/NAME].
    #[arg(long)]
    out: Option<PathBuf>,
    /// Folder of the generated data sets.
    #[arg(long, default_value = "data")]
    data: PathBuf,
    /// Stop cleanly after this many minutes, data generation, validation and report included.
    #[arg(long, value_parser = parse_minutes)]
    minutes: Option<Duration>,
    /// Start from the weights of this checkpoint or official state (fine-tuning) when the run has none of its own. With
    /// `model.color.weights` of a hybrid encoder, from those of its other parts.
    #[arg(long, value_name = "FILE")]
    init: Option<PathBuf>,
    /// Resume the run in the folder (the default).
    #[arg(long, conflicts_with = "fresh")]
    resume: bool,
    /// Delete an earlier run in the folder.
    #[arg(long)]
    fresh: bool,
    /// Resume from the weights alone where the optimizer's saved state is damaged.
    #[arg(long, conflicts_with = "fresh")]
    reset_optimizer: bool,
    /// Save and exit when the run has taken this many steps.
    #[arg(long, value_name = "STEP")]
    stop_at: Option<u64>,
    #[command(flatten)]
    device: DeviceOption,
    /// Threads of the CPU backend and of data preparation [default: one per core].
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=i64::from(MAX_THREADS)))]
    threads: Option<u16>,
}

/// Exit code of a call that stopped before what was asked for.
const INTERRUPTED: u8 = 4;
/// Ten years.
const MOST_MINUTES: f64 = 60.0 * 24.0 * 3652.0;

fn parse_minutes(text: &str) -> Result<Duration, String> {
    let minutes = text.parse().ok().filter(|minutes| *minutes > 0.0 && *minutes <= MOST_MINUTES);
    let minutes: f64 =
        minutes.ok_or_else(|| format!("expected a number above 0 and at most {MOST_MINUTES}"))?;
    Ok(Duration::from_secs_f64(60.0 * minutes))
}

fn main() -> ExitCode {
    keep_freed_memory();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into()),
        )
        .with_writer(std::io::stderr)
        .without_time()
        .log_internal_errors(false)
        .init();
    match run(Arguments::parse()) {
        Ok(code) => code,
        Err(error) => {
            tell!("error: {}", explain(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> anyhow::Result<ExitCode> {
    let (arguments, kind, default) = match arguments.command {
        None => (arguments.run, Kind::Pose, "geo"),
        Some(Command::Distil { run, teacher }) => (run, Kind::Encoder(teacher), "distil"),
        Some(Command::Proposals { run }) => (run, Kind::Proposals, "proposals"),
    };
    let config = load(arguments.config.as_deref().unwrap_or(Path::new(default)), &arguments.overrides)?;
    if arguments.print_config {
        print_text(&config.to_commented_toml()?);
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().context("--threads")?;
    }
    let (device, backend) = arguments.device.choice().open()?;
    let out = arguments.out.unwrap_or_else(|| Path::new("runs").join(&config.name));
    let interrupt = Arc::new(Interrupt::default());
    interrupt
        .on_signals(|| tell!("saving; press Ctrl-C again to leave at once"))
        .context("cannot handle signals")?;
    tell!("run {} on {backend}, results in {}", config.name, out.display());
    let options = TrainOptions {
        out: out.clone(),
        data_root: arguments.data,
        init: arguments.init,
        fresh: arguments.fresh,
        reset_optimizer: arguments.reset_optimizer,
        time_limit: arguments.minutes,
        stop_at: arguments.stop_at,
        device,
        interrupt: interrupt.clone(),
        observer: Arc::new(ProgressBars::default()),
    };
    let outcome = match &kind {
        Kind::Pose => train(&config, &options)?,
        Kind::Encoder(teacher) => distil(&config, &options, teacher)?,
        Kind::Proposals => train_proposals(&config, &options)?,
    };
    let weights = Some(out.join("best.safetensors")).filter(|path| path.exists());
    print_summary(&outcome, &config, weights.as_deref());
    let early = match outcome.stop_reason {
        StopReason::Interrupted => interrupt.is_requested(),
        StopReason::TimeUp => weights.is_none(),
        _ => false,
    };
    Ok(if early { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn load(path: &Path, overrides: &[String]) -> anyhow::Result<Config> {
    let built_in = path.to_str().filter(|name| unopose_core::config::EMBEDDED_NAMES.contains(name));
    Ok(match built_in {
        Some(name) if !path.is_file() => Config::embedded(name, overrides)?,
        _ => Config::load(path, overrides)?,
    })
}

fn print_summary(outcome: &TrainOutcome, config: &Config, weights: Option<&Path>) {
    let step = outcome.step;
    say!(
        "{}",
        match outcome.stop_reason {
            StopReason::AlreadyFinished => format!("already finished: {step} steps (--fresh starts again)"),
            StopReason::Finished => format!("finished: {step} steps"),
            StopReason::TimeUp => format!("time is up after {step} of {} steps", config.train.steps),
            StopReason::Interrupted =>
                format!("interrupted after {step} of {} steps, saved", config.train.steps),
            other => format!("stopped after {step} of {} steps: {other:?}", config.train.steps),
        }
    );
    let first = outcome.validations.first();
    let last = outcome.validations.last().filter(|last| first.is_some_and(|first| first.step != last.step));
    let records: Vec<&ValidationRecord> = first.into_iter().chain(last).collect();
    let every =
        |holds: fn(&ValidationRecord) -> bool| !records.is_empty() && records.iter().all(|r| holds(r));
    let table = if every(|record| record.roc_area.is_some()) {
        feature_table(&records)
    } else if every(|record| record.proposals.is_some()) {
        proposal_table(&records)
    } else {
        pose_table(&records)
    };
    print_text(&table.to_string());
    match weights {
        Some(path) => say!("weights: {}", path.display()),
        None => say!("no weights yet; the same command goes on"),
    }
}

fn pose_table(records: &[&ValidationRecord]) -> Table {
    let columns =
        ["validation", "loss", "rotation", "translation", "5deg/5cm", "15deg", "15deg by print", "AR"];
    let mut table = Table::new(columns);
    for record in records {
        table.push([
            format!("step {}", record.step),
            format!("{:.3}", record.loss),
            format!("{:.1} deg", record.median_rotation_deg),
            format!("{:.1} cm", 100.0 * record.median_translation_m),
            format!("{:.1} %", 100.0 * record.within_5deg_5cm),
            format!("{:.1} %", 100.0 * record.within_15deg),
            record.print_within_15deg.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share)),
            record.average_recall.map_or("-".into(), |ar| format!("{ar:.3}")),
        ]);
    }
    table
}

fn feature_table(records: &[&ValidationRecord]) -> Table {
    let mut table = Table::new(["validation", "loss", "ROC area"]);
    for record in records {
        let area = record.roc_area.map_or("-".into(), |area| format!("{area:.3}"));
        table.push([format!("step {}", record.step), format!("{:.3}", record.loss), area]);
    }
    table
}

fn proposal_table(records: &[&ValidationRecord]) -> Table {
    let columns =
        ["validation", "loss", "recall at 0.5", "recall at 0.75", "mean overlap", "proposals per image"];
    let mut table = Table::new(columns);
    for record in records {
        let Some(recall) = &record.proposals else { continue };
        table.push([
            format!("step {}", record.step),
            format!("{:.3}", record.loss),
            format!("{:.3}", recall.recall_50),
            format!("{:.3}", recall.recall_75),
            format!("{:.3}", recall.mean_iou),
            format!("{:.1}", recall.proposals),
        ]);
    }
    table
}
