//! `unoinfer features`.

use std::path::PathBuf;

use clap::Args;
use unopose_bench::{FeatureSource, features_table, measure_features};
use unopose_cli::{DeviceOption, print_text};

use super::progress::ProgressDisplay;

#[derive(Args)]
pub struct FeaturesArguments {
    /// List of pairs of views with known poses, as `bench pairs` takes it
    #[arg(long, value_name = "JSON")]
    list: PathBuf,
    /// Checkpoints whose colour encoders are measured: of whole networks or of `unotrain distil`
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    checkpoint: Vec<PathBuf>,
    /// DINOv2 weights that are measured beside them
    #[arg(long, value_name = "FILE")]
    teacher: Option<PathBuf>,
    /// Folder for features.json and features.md
    #[arg(long, value_name = "DIR", default_value = "features")]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceOption,
}

pub fn run(arguments: &FeaturesArguments) -> anyhow::Result<()> {
    let (device, _) = arguments.device.choice().open()?;
    let mut sources = vec![FeatureSource::colors()];
    for path in &arguments.checkpoint {
        sources.push(FeatureSource::encoder(path, &device)?);
    }
    if let Some(path) = &arguments.teacher {
        sources.push(FeatureSource::transformer(path, &device)?);
    }
    let display = ProgressDisplay::new("measuring");
    let progress = |done: usize, total: usize| display.set(done, total);
    let measured = measure_features(&arguments.list, &sources, &device, &arguments.out, &progress)?;
    display.finish();
    print_text(&features_table(&sources, &measured));
    Ok(())
}
