//! `unogen`: synthetic RGB-D sets with exact poses, written as MegaPose-style shards or BOP folders, and checks of such
//! sets.

mod check;
mod generate;

use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use unopose_cli::tell;
use unopose_core::{config::MAX_THREADS, explain};
use unopose_synth::SynthError;

/// Makes synthetic RGB-D images of procedural objects (or of your meshes) in clutter, with exact poses and masks.
///
/// Killing it loses at most the shard being written; the same command continues to the identical set. Exit code 4 when a
/// signal (Ctrl-C, SIGTERM, SIGHUP) ended it.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    generate: Option<generate::Arguments>,
    /// Threads; one per core where not given. The result does not depend on it.
    #[arg(long, global = true, value_parser = clap::value_parser!(u16).range(1..=i64::from(MAX_THREADS)))]
    jobs: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    Check(check::Arguments),
}

/// Exit code of a generation that a signal ended.
const INTERRUPTED: u8 = 4;

fn main() -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .log_internal_errors(false)
        .init();
    match run(Arguments::parse()) {
        Ok(code) => code,
        Err(error) if matches!(error.downcast_ref(), Some(SynthError::Stopped)) => {
            tell!("interrupted; the same command goes on");
            ExitCode::from(INTERRUPTED)
        }
        Err(error) => {
            tell!("error: {}", explain(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> Result<ExitCode> {
    let threads = arguments.jobs.unwrap_or(0).into();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("thread pool")?;
    pool.install(|| match (arguments.command, arguments.generate) {
        (Some(Command::Check(check)), _) => check::run(&check),
        (None, Some(generate)) => generate::run(&generate).map(|()| ExitCode::SUCCESS),
        (None, None) => {
            <Arguments as clap::CommandFactory>::command().print_help()?;
            Ok(ExitCode::from(2))
        }
    })
}
