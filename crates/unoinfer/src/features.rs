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
    /// Blocks of the teacher after which its tokens are read [default: three quarters of them]
    #[arg(long, value_name = "N", requires = "teacher", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(1..))]
    teacher_blocks: Vec<u16>,
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
        let given = arguments.teacher_blocks.iter().map(|&blocks| Some(blocks.into()));
        let default = arguments.teacher_blocks.is_empty().then_some(None);
        for blocks in given.chain(default) {
            sources.push(FeatureSource::transformer(path, blocks, &device)?);
        }
    }
    let display = ProgressDisplay::new("measuring");
    let progress = |done: usize, total: usize| display.set(done, total);
    let measured = measure_features(&arguments.list, &sources, &device, &arguments.out, &progress)?;
    display.finish();
    print_text(&features_table(&sources, &measured));
    Ok(())
}
