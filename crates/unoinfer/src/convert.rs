//! `unoinfer inspect` and `unoinfer export`.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use unopose_cli::{print_text, say};
use unopose_nn::{
    checkpoint::{self, Backbone, OfficialState, TensorFile},
    device::DeviceChoice,
};
use unopose_segment::sam::SamCheckpoint;

#[derive(Args)]
pub struct InspectArguments {
    /// Checkpoint of unotrain, official state, DINOv2 backbone or Segment Anything (safetensors, or PyTorch .pth/.pt)
    file: PathBuf,
    /// Also list every tensor
    #[arg(long)]
    tensors: bool,
}

#[derive(Args)]
pub struct ExportArguments {
    /// Form of the new file
    #[arg(long, value_name = "FORM")]
    to: Form,
    /// Checkpoint of unotrain
    input: PathBuf,
    /// New safetensors file
    output: PathBuf,
}

#[derive(Clone, Copy, ValueEnum)]
enum Form {
    /// Names and shapes of the official PyTorch release
    Official,
    /// The checkpoint without its vision transformer, to be completed by --backbone
    WithoutBackbone,
}

/// The networks' parts, whose numbers are counted apart.
const PARTS: [&str; 9] = [
    "feature_extraction",
    "geo_embedding",
    "coarse_point_matching",
    "fine_point_matching",
    "patch_embed",
    "blocks",
    "image_encoder",
    "prompt_encoder",
    "mask_decoder",
];

pub fn inspect(arguments: &InspectArguments) -> anyhow::Result<()> {
    let path = &arguments.file;
    let mut out = String::new();
    let (tensors, kind) = match own(path)? {
        Some(file) => (file.tensors, "checkpoint of unotrain"),
        None => match Backbone::read(path)? {
            Some(backbone) => {
                write!(out, "{}", describe(&backbone))?;
                (backbone.tensors, "DINOv2 backbone")
            }
            None => match SamCheckpoint::read(path)? {
                Some(sam) => {
                    write!(out, "{}{}", notes(&sam.notices, &sam.unused), sam.sizes)?;
                    (sam.tensors, "Segment Anything")
                }
                None => {
                    let state = OfficialState::read(path)?;
                    write!(out, "{}{}", notes(&state.notices, &state.unused), state.sizes())?;
                    (state.tensors, "official state of the PyTorch release")
                }
            },
        },
    };
    writeln!(out, "kind: {kind}")?;
    let count = |part: &str| -> usize {
        tensors.iter().filter(|(name, _)| name.starts_with(part)).map(|(_, t)| t.num_elements()).sum()
    };
    writeln!(out, "tensors: {}, {} numbers", tensors.len(), count(""))?;
    for part in PARTS {
        let numbers = count(part);
        if numbers > 0 {
            writeln!(out, "  {part}: {numbers}")?;
        }
    }
    if own(path)?.is_some() {
        let meta = checkpoint::read_meta(path)?;
        writeln!(out, "step: {}", meta.step)?;
        for (key, value) in &meta.extra {
            writeln!(out, "{key}: {value}")?;
        }
        writeln!(out, "configuration:\n{}", checkpoint::read_config(path)?.to_toml()?)?;
    }
    if arguments.tensors {
        for (name, t) in &tensors {
            writeln!(out, "{name} {:?}", t.shape())?;
        }
    }
    print_text(&out);
    Ok(())
}

/// Conversions and stored tensors that nothing reads, a line each.
fn notes(notices: &[String], unused: &[String]) -> String {
    let unused = (!unused.is_empty()).then(|| format!("stored but not used: {}", unused.join(", ")));
    notices.iter().chain(&unused).map(|note| format!("note: {note}\n")).collect()
}

fn describe(backbone: &Backbone) -> String {
    let unknown: String = backbone.unknown.iter().map(|name| format!("unknown tensor: {name}\n")).collect();
    let notes = notes(&backbone.notices, &backbone.unused);
    format!("{notes}{unknown}{}naming: {}\n", backbone.sizes(), backbone.naming)
}

pub fn export(arguments: &ExportArguments) -> anyhow::Result<()> {
    let (device, _) = DeviceChoice::Auto.open()?;
    match arguments.to {
        Form::Official => {
            let (model, config, _) = checkpoint::load(&arguments.input, &device)?;
            checkpoint::export_official(&arguments.output, &model, &config.model)?;
        }
        Form::WithoutBackbone => {
            checkpoint::strip_backbone(&arguments.input, &arguments.output, &device)?;
        }
    }
    say!("{}", arguments.output.display());
    Ok(())
}

/// The file when this program wrote it.
fn own(path: &Path) -> anyhow::Result<Option<TensorFile>> {
    let file = match TensorFile::read(path) {
        Ok(file) => file,
        // Official files hold counters that are no floats, and pickles are no safetensors; their reader judges them.
        Err(_) => return Ok(None),
    };
    Ok(file.metadata.contains_key("format_version").then_some(file))
}
