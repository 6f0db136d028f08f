//! `unogen check`.

use std::{fmt::Write as _, path::PathBuf, process::ExitCode};

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use unopose_cli::print_text;
use unopose_synth::CheckReport;

/// Checks a MegaPose or BOP folder: damaged or missing files, masks against visibility, poses against masks and depth
/// (by drawing the models), units, duplicate keys, index files and target lists.
///
/// Exit code 1 when anything is wrong.
#[derive(clap::Args)]
pub struct Arguments {
    /// The folder: with shards (or train_pbr_web/), or with BOP splits.
    dir: PathBuf,
    /// Decode every N-th image of each shard or scene only; the others are counted.
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// Findings to print.
    #[arg(long, default_value_t = 50)]
    findings: usize,
    /// Print distributions: brightness, holes, depth error, distance, visibility ...
    #[arg(long)]
    statistics: bool,
}

pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let bar = ProgressBar::no_length();
    bar.set_style(ProgressStyle::with_template("checking {bar:40} {pos}/{len} {eta} left")?);
    let progress = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let report = unopose_synth::check_dataset(&arguments.dir, arguments.every, &progress)?;
    bar.finish_and_clear();
    print_text(&text(arguments, &report)?);
    Ok(ExitCode::from(u8::from(report.finding_count() > 0)))
}

fn text(arguments: &Arguments, report: &CheckReport) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let root = arguments.dir.display().to_string();
    for part in &report.parts {
        let name = part.name.strip_prefix(&root).unwrap_or(&part.name).trim_start_matches('/');
        write!(
            out,
            "{name}: {} images, {} decoded, {} instances",
            part.images, part.decoded, part.instances
        )?;
        if part.bytes > 0 {
            write!(out, ", {:.1} MB", part.bytes as f64 / 1e6)?;
        }
        match part.finding_count {
            0 => writeln!(out, ", ok")?,
            count => writeln!(out, ", {count} findings")?,
        }
    }
    for finding in report.findings().take(arguments.findings) {
        writeln!(out, "! {}: {}", finding.place, finding.what)?;
    }
    if arguments.statistics {
        writeln!(
            out,
            "{:<40} {:>8} {:>10} {:>10} {:>10} {:>10}",
            "", "count", "mean", "10 %", "median", "90 %"
        )?;
        for (name, h) in report.statistics().all() {
            let [low, middle, high] = [0.1, 0.5, 0.9].map(|q| h.quantile(q));
            writeln!(
                out,
                "{name:<40} {:>8} {:>10.5} {low:>10.5} {middle:>10.5} {high:>10.5}",
                h.count(),
                h.mean()
            )?;
        }
    }
    let (mended, skipped) = (report.mended_masks(), report.skipped_instances());
    if mended + skipped > 0 {
        writeln!(
            out,
            "training mends {mended} inverted masks and skips {skipped} instances of these images"
        )?;
    }
    let (parts, images, count) = (report.parts.len(), report.images(), report.finding_count());
    writeln!(out, "{root}: {images} images in {parts} parts, {count} findings")?;
    Ok(out)
}
