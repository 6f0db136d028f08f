//! `unoinfer inspect` and `unoinfer export`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use unopose::{
    checkpoint::{self, OfficialState, TensorFile},
    device::DeviceChoice,
};

#[derive(Args)]
pub struct InspectArguments {
    /// Checkpoint of unotrain, or official state (safetensors, or PyTorch .pth/.pt)
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
}

pub fn inspect(arguments: &InspectArguments) -> anyhow::Result<()> {
    let path = &arguments.file;
    let (tensors, kind) = match own(path)? {
        Some(file) => (file.tensors, "checkpoint of unotrain"),
        None => {
            let state = OfficialState::read(path)?;
            for notice in &state.notices {
                println!("note: {notice}");
            }
            if !state.unused.is_empty() {
                println!("note: stored but not used: {}", state.unused.join(", "));
            }
            println!("sizes: {:#?}", state.sizes());
            (state.tensors, "official state of the PyTorch release")
        }
    };
    println!("kind: {kind}");
    let count = |part: &str| -> usize {
        tensors.iter().filter(|(name, _)| name.starts_with(part)).map(|(_, t)| t.num_elements()).sum()
    };
    println!("tensors: {}, {} numbers", tensors.len(), count(""));
    for part in ["feature_extraction", "geo_embedding", "coarse_point_matching", "fine_point_matching"] {
        println!("  {part}: {}", count(part));
    }
    if own(path)?.is_some() {
        let meta = checkpoint::read_meta(path)?;
        println!("step: {}", meta.step);
        meta.extra.iter().for_each(|(key, value)| println!("{key}: {value}"));
        println!("configuration:\n{}", checkpoint::read_config(path)?.to_toml()?);
    }
    if arguments.tensors {
        tensors.iter().for_each(|(name, t)| println!("{name} {:?}", t.shape()));
    }
    Ok(())
}

pub fn export(arguments: &ExportArguments) -> anyhow::Result<()> {
    let Form::Official = arguments.to;
    let (device, _) = DeviceChoice::Auto.open()?;
    let (model, config, _) = checkpoint::load(&arguments.input, &device)?;
    checkpoint::export_official(&arguments.output, &model, &config.model)?;
    println!("{}", arguments.output.display());
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
