//! `unogen` without a subcommand: making a set.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use unopose_cli::{print_text, say, tell};
use unopose_core::{
    config::{Config, SynthCameraConfig, SynthConfig},
    interrupt::Interrupt,
};
use unopose_dataset::formats::{BopDataset, megapose::ShardDataset};
use unopose_synth::{GenerationProgress, Stage};

#[derive(clap::Args)]
#[group(id = "generate")]
pub struct Arguments {
    /// Amount of data: tiny 200 images of 32 objects, small 5000 of 400, full 1 million of 20000 at 640 x 480; objects
    /// of 3 to 40 cm, 3 to 12 in a scene, seen from 0.4 to 2 m.
    #[arg(long, value_enum, default_value_t = Preset::Small)]
    preset: Preset,
    /// A configuration file whose `[synth]` part is used instead of a preset.
    #[arg(long, conflicts_with = "preset")]
    config: Option<PathBuf>,
    /// Any field of the `[synth]` part, for example camera.distance=[0.5,1.0], bins=0.5 or mesh_size=megapose.
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Print the `[synth]` part with all defaults and changes as TOML, a comment with meaning, unit and default before every
    /// key, and exit. The output is a file for --config.
    #[arg(long)]
    print_config: bool,
    /// Seed of the whole set [default: that of the configuration, 0 for presets].
    #[arg(long)]
    seed: Option<u64>,
    /// Folder to fill.
    #[arg(long, required_unless_present = "print_config")]
    out: Option<PathBuf>,
    /// Remove what an earlier generation wrote there first.
    #[arg(long)]
    overwrite: bool,
    /// Number of images instead of the preset's.
    #[arg(long)]
    images: Option<usize>,
    /// A number of procedural objects, or a folder of meshes (ply, obj, stl, glb; Google Scanned Objects; ShapeNet) to
    /// use besides them.
    #[arg(long)]
    objects: Option<String>,
    /// Unit of the meshes in metres, 0.001 for millimetres.
    #[arg(long)]
    mesh_scale: Option<f32>,
    /// Folder of photographs (jpg, png; searched recursively) for the prints of packages; makes 0.6 of the objects packages where
    /// the configuration has none.
    #[arg(long, value_name = "DIR")]
    textures: Option<PathBuf>,
    /// Image width instead of the configuration's, pixels.
    #[arg(long)]
    width: Option<u32>,
    /// Image height instead of the configuration's, pixels.
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

/// Share of packages with `--textures`.
const PRINTED_WITH_TEXTURES: f32 = 0.6;

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
    let camera = SynthCameraConfig { distance: [0.4, 2.0], ..SynthCameraConfig::default() };
    let wide =
        SynthConfig { diameter: [0.03, 0.4], objects_per_scene: [3, 12], camera, ..SynthConfig::default() };
    let mut config = match (&arguments.config, arguments.preset) {
        (Some(file), _) => Config::load(file, &[])?.synth,
        (None, Preset::Tiny) => SynthConfig { images: 200, objects: 32, ..wide },
        (None, Preset::Small) => SynthConfig { images: 5000, objects: 400, images_per_shard: 250, ..wide },
        (None, Preset::Full) => SynthConfig {
            images: 1_000_000,
            objects: 20_000,
            images_per_shard: 1000,
            width: 640,
            height: 480,
            texture_size: 512,
            ..wide
        },
    };
    config.seed = arguments.seed.unwrap_or(config.seed);
    config.images = arguments.images.unwrap_or(config.images);
    config.width = arguments.width.unwrap_or(config.width);
    config.height = arguments.height.unwrap_or(config.height);
    config.mesh_scale = arguments.mesh_scale.unwrap_or(config.mesh_scale);
    if let Some(folder) = &arguments.textures {
        config.texture_folder.clone_from(folder);
        if config.printed == 0.0 {
            config.printed = PRINTED_WITH_TEXTURES;
        }
    }
    if let Some(objects) = &arguments.objects {
        match objects.parse() {
            Ok(count) => config.objects = count,
            Err(_) if PathBuf::from(objects).is_dir() => config.mesh_folder = objects.into(),
            Err(_) => bail!("--objects {objects}: neither a number nor a folder"),
        }
    }
    config.check()?;
    let tree = Config { synth: config, ..Config::default() };
    let fields: Vec<String> = arguments.set.iter().map(|field| format!("synth.{field}")).collect();
    Ok(Config::from_toml(&tree.to_toml()?, Path::new("--set"), &fields)?.synth)
}

pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.format == Format::Bop && arguments.shards.is_some() {
        bail!("--shards belongs to --format megapose");
    }
    if arguments.overwrite && arguments.shards.is_some() {
        bail!("--overwrite would remove the shards of other machines; leave out --shards");
    }
    let config = configuration(arguments)?;
    if arguments.print_config {
        print_text(&config.to_commented_toml()?);
        return Ok(());
    }
    let out = arguments.out.as_deref().context("--out is missing")?;
    if arguments.overwrite {
        unopose_synth::remove_generated(&config, out)?;
    }
    let interrupt = Arc::new(Interrupt::default());
    interrupt
        .on_signals(|| tell!("finishing the scenes in work; again to leave at once"))
        .context("cannot handle signals")?;
    let started = std::time::Instant::now();
    let bar = Bar::default();
    let report = |progress: GenerationProgress| {
        bar.show(&progress);
        if interrupt.is_requested() {
            progress.stop();
        }
    };
    let summary = match arguments.shards.clone() {
        _ if arguments.format == Format::Bop => unopose_synth::generate_bop(&config, out, &report),
        Some(shards) => unopose_synth::generate_shards(&config, out, shards, &report),
        None => unopose_synth::generate(&config, out, &report),
    }?;
    let seconds = started.elapsed().as_secs_f64();
    let rate = summary.images_written as f64 / seconds.max(1e-9);
    say!(
        "{}: {} images in {} parts written, {} parts kept, {seconds:.1} s ({rate:.1} images/s)",
        out.display(),
        summary.images_written,
        summary.shards_written,
        summary.shards_kept,
    );
    if summary.meshes_replaced > 0 {
        say!(
            "the meshes of {} objects could not be used (see the warnings); procedural ones took their place",
            summary.meshes_replaced
        );
    }
    if let Some(file) = &arguments.contact_sheet {
        draw_samples(arguments.format, out, file)?;
        say!("contact sheet: {}", file.display());
    }
    Ok(())
}

fn draw_samples(format: Format, set: &Path, file: &Path) -> Result<()> {
    const SHAPE: [u32; 2] = [3, 6];
    if format == Format::Megapose {
        let dataset = ShardDataset::open(set)?;
        let load = |i: usize| dataset.load(i as u32);
        return Ok(unopose_synth::contact_sheet(dataset.image_keys().len(), &load, file, SHAPE)?);
    }
    let split = BopDataset::open(set)?.test_split()?;
    let mut images = Vec::new();
    for &scene in split.scene_ids() {
        images.extend(split.scene(scene)?.image_ids().map(|image| (scene, image)));
    }
    Ok(unopose_synth::contact_sheet(images.len(), &|i| split.load(images[i].0, images[i].1), file, SHAPE)?)
}

/// One progress bar per stage, fed from several threads.
#[derive(Default)]
struct Bar(Mutex<Option<(Stage, ProgressBar)>>);

impl Bar {
    fn show(&self, progress: &GenerationProgress) {
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
