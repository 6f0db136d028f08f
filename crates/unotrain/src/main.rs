//! Trains UNOPose: `unotrain --config configs/geo.toml`.

mod progress;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use anyhow::Context as _;
use clap::Parser;
use unopose_cli::{DeviceOption, print_text};
use unopose_core::{config::Config, explain};
use unopose_eval::report::Table;
use unopose_nn::device::keep_freed_memory;
use unopose_train::{Interrupt, StopReason, TrainOptions, TrainOutcome, train};

use progress::ProgressBars;

/// Train UNOPose. Without data it generates its synthetic training and validation sets first; an interrupted run
/// resumes.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Configuration file, or the name of a built-in one: geo, unopose, smoke.
    #[arg(long, default_value = "geo")]
    config: PathBuf,
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
    #[arg(long)]
    minutes: Option<f64>,
    /// Start from the weights of this checkpoint or official state (fine-tuning) when the run has none of its own.
    #[arg(long, value_name = "FILE")]
    init: Option<PathBuf>,
    /// Resume the run in the folder (the default).
    #[arg(long, conflicts_with = "fresh")]
    resume: bool,
    /// Delete an earlier run in the folder.
    #[arg(long)]
    fresh: bool,
    /// Save and exit when the run has taken this many steps.
    #[arg(long, value_name = "STEP")]
    stop_at: Option<u64>,
    #[command(flatten)]
    device: DeviceOption,
    /// Threads of the CPU backend and of data preparation [default: one per core].
    #[arg(long)]
    threads: Option<usize>,
}

fn main() -> ExitCode {
    keep_freed_memory();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into()),
        )
        .with_writer(std::io::stderr)
        .without_time()
        .init();
    match run(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", explain(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> anyhow::Result<()> {
    let config = load(&arguments.config, &arguments.overrides)?;
    if arguments.print_config {
        return Ok(print_text(&config.to_commented_toml()?)?);
    }
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("--threads")?;
    }
    let time_limit = arguments
        .minutes
        .map(|minutes| Duration::try_from_secs_f64(60.0 * minutes).context("--minutes"))
        .transpose()?;
    let (device, backend) = arguments.device.choice().open()?;
    let out = arguments.out.unwrap_or_else(|| Path::new("runs").join(&config.name));
    let interrupt = Arc::new(Interrupt::default());
    let signalled = interrupt.clone();
    ctrlc::set_handler(move || {
        if !signalled.request() {
            std::process::exit(130);
        }
        eprintln!("saving; press Ctrl-C again to leave at once");
    })
    .context("cannot handle Ctrl-C")?;
    eprintln!("run {} on {backend}, results in {}", config.name, out.display());
    let options = TrainOptions {
        out: out.clone(),
        data_root: arguments.data,
        init: arguments.init,
        fresh: arguments.fresh,
        time_limit,
        stop_at: arguments.stop_at,
        device,
        interrupt,
        observer: Arc::new(ProgressBars::default()),
    };
    let outcome = train(&config, &options)?;
    print_summary(&outcome, &config, &out);
    Ok(())
}

fn load(path: &Path, overrides: &[String]) -> anyhow::Result<Config> {
    let built_in = path.to_str().filter(|name| unopose_core::config::EMBEDDED_NAMES.contains(name));
    Ok(match built_in {
        Some(name) if !path.is_file() => Config::embedded(name, overrides)?,
        _ => Config::load(path, overrides)?,
    })
}

fn print_summary(outcome: &TrainOutcome, config: &Config, out: &Path) {
    let step = outcome.step;
    println!(
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
    let mut table = Table::new(["validation", "loss", "rotation", "translation", "5deg/5cm", "15deg", "AR"]);
    let first = outcome.validations.first();
    let last = outcome.validations.last().filter(|last| first.is_some_and(|first| first.step != last.step));
    for record in first.into_iter().chain(last) {
        table.push([
            format!("step {}", record.step),
            format!("{:.3}", record.loss),
            format!("{:.1} deg", record.median_rotation_deg),
            format!("{:.1} cm", 100.0 * record.median_translation_m),
            format!("{:.1} %", 100.0 * record.within_5deg_5cm),
            format!("{:.1} %", 100.0 * record.within_15deg),
            record.average_recall.map_or("-".into(), |ar| format!("{ar:.3}")),
        ]);
    }
    print!("{table}");
    println!("weights: {}", out.join("best.safetensors").display());
}
