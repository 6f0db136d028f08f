//! `unogen` without a subcommand: making a set.

use std::{ops::Range, path::PathBuf, sync::Mutex};

use anyhow::{Result, bail};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use unopose::{
    config::SynthConfig,
    formats::megapose::ShardDataset,
    synth::{self, Progress, Stage},
};

#[derive(clap::Args)]
#[group(id = "generate")]
pub struct Arguments {
    /// Amount of data: tiny 200 images of 32 objects, small 5000 of 400, full 1 million of 20000 at 640 x 480.
    #[arg(long, value_enum, default_value_t = Preset::Small)]
    preset: Preset,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder to fill.
    #[arg(long)]
    out: PathBuf,
    /// Remove what an earlier generation wrote there first.
    #[arg(long)]
    overwrite: bool,
    /// Number of images instead of the preset's.
    #[arg(long)]
    images: Option<usize>,
    /// A number of procedural objects, or a folder of meshes (ply, obj, stl, glb) to use besides them.
    #[arg(long)]
    objects: Option<String>,
    /// Unit of the meshes in metres.
    #[arg(long, default_value_t = 1.0)]
    mesh_scale: f32,
    /// Image size.
    #[arg(long)]
    width: Option<u32>,
    #[arg(long)]
    height: Option<u32>,
    /// Layout of the set: training shards, or a test set with targets and references.
    #[arg(long, value_enum, default_value_t = Format::Megapose)]
    format: Format,
    /// Only these shards, for sets made on many machines; a last call without it writes models and index files.
    #[arg(long, value_parser = parse_range)]
    shards: Option<Range<u32>>,
    /// Also write a picture of samples with masks and axes.
    #[arg(long)]
    contact_sheet: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Preset {
    Tiny,
    Small,
    Full,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Megapose,
    Bop,
}

fn parse_range(text: &str) -> Result<Range<u32>, String> {
    let parsed = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    parsed
        .filter(|r| r.start < r.end)
        .ok_or_else(|| format!("{text:?}, expected FIRST..END with FIRST < END"))
}

fn configuration(arguments: &Arguments) -> Result<SynthConfig> {
    let default = SynthConfig { seed: arguments.seed, ..SynthConfig::default() };
    let mut config = match arguments.preset {
        Preset::Tiny => SynthConfig { images: 200, objects: 32, ..default },
        Preset::Small => SynthConfig { images: 5000, objects: 400, images_per_shard: 250, ..default },
        Preset::Full => SynthConfig {
            images: 1_000_000,
            objects: 20_000,
            images_per_shard: 1000,
            width: 640,
            height: 480,
            texture_size: 512,
            ..default
        },
    };
    config.images = arguments.images.unwrap_or(config.images);
    config.width = arguments.width.unwrap_or(config.width);
    config.height = arguments.height.unwrap_or(config.height);
    if let Some(objects) = &arguments.objects {
        match objects.parse() {
            Ok(count) => config.objects = count,
            Err(_) if PathBuf::from(objects).is_dir() => {
                config.mesh_folder = objects.into();
                config.mesh_scale = arguments.mesh_scale;
            }
            Err(_) => bail!("--objects {objects}: neither a number nor a folder"),
        }
    }
    Ok(config)
}

pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.format == Format::Bop && (arguments.shards.is_some() || arguments.contact_sheet.is_some()) {
        bail!("--shards and --contact-sheet belong to --format megapose");
    }
    if arguments.overwrite && arguments.shards.is_some() {
        bail!("--overwrite would remove the shards of other machines; leave out --shards");
    }
    let config = configuration(arguments)?;
    if arguments.overwrite {
        synth::remove_generated(&arguments.out)?;
    }
    let started = std::time::Instant::now();
    let bar = Bar::default();
    let report = |progress: Progress| bar.show(progress);
    let summary = match arguments.shards.clone() {
        _ if arguments.format == Format::Bop => synth::generate_bop(&config, &arguments.out, &report),
        Some(shards) => synth::generate_shards(&config, &arguments.out, shards, &report),
        None => synth::generate(&config, &arguments.out, &report),
    }?;
    let seconds = started.elapsed().as_secs_f64();
    let rate = summary.images_written as f64 / seconds.max(1e-9);
    println!(
        "{}: {} images in {} parts written, {} parts kept, {seconds:.1} s ({rate:.1} images/s)",
        arguments.out.display(),
        summary.images_written,
        summary.shards_written,
        summary.shards_kept,
    );
    if let Some(file) = &arguments.contact_sheet {
        let dataset = ShardDataset::open(&arguments.out)?;
        synth::contact_sheet(&dataset, file, 3, 6, false)?;
        println!("contact sheet: {}", file.display());
    }
    Ok(())
}

/// One progress bar per stage, fed from several threads.
#[derive(Default)]
struct Bar(Mutex<Option<(Stage, ProgressBar)>>);

impl Bar {
    fn show(&self, progress: Progress) {
        let mut current = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if current.as_ref().is_none_or(|(stage, _)| *stage != progress.stage) {
            let name = match progress.stage {
                Stage::Objects => "objects",
                Stage::Images => "images",
            };
            let style = ProgressStyle::with_template("{msg:>8} {bar:40} {pos}/{len} {per_sec} {eta} left");
            let bar = ProgressBar::new(progress.total as u64).with_message(name);
            *current = Some((
                progress.stage,
                bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())),
            ));
        }
        if let Some((_, bar)) = current.as_ref() {
            bar.set_position(bar.position().max(progress.done as u64));
            if progress.done >= progress.total {
                bar.finish();
            }
        }
    }
}
