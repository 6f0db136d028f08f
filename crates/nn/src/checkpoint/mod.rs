//! Weights in safetensors files.
//!
//! [`save`] writes a network with its configuration, [`load`] makes the network the file describes and fills it,
//! [`load_into`] fills a given one. Loading is strict: missing, unknown and wrongly shaped tensors are all listed.
//!
//! Tensor names and layouts are those of the official PyTorch state (`coarse_point_matching.in_proj.weight`, linear
//! weights `[out, in]`, normalisation `weight`/`bias`), so that files can be exchanged with it. The metadata hold the
//! format version, the step, the complete configuration as TOML, and whatever the writer adds.

mod backbone;
mod claims;
mod error;
mod file;
mod named;
mod official;
mod shapes;
mod stored;
mod without_backbone;

pub use backbone::{Backbone, BackboneSizes, Naming, Resampling, load_backbone, load_transformer};
pub use error::{CheckpointError, Mismatch};
pub use file::TensorFile;
pub use named::{NamedTensors, contents};
pub use official::{OfficialSizes, OfficialState, export_official, load_official};
pub use shapes::state_shapes;
pub use stored::Layout;
pub use without_backbone::{load_with_backbone, strip_backbone};

use std::{collections::BTreeMap, path::Path};

use burn::{
    module::Module,
    store::{BurnToPyTorchAdapter, ModuleSnapshot, PyTorchToBurnAdapter, bridge},
    tensor::{Device, TensorData},
};
use unopose_core::config::{Config, ConfigError, ModelConfig};

use crate::model::{ProposalNetwork, UnoPose};

/// Version of the file layout; a reader refuses any other.
const FORMAT_VERSION: &str = "1";

/// What a checkpoint says besides its weights and configuration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// Optimizer steps taken.
    pub step: u64,
    /// Further entries of the writer.
    pub extra: BTreeMap<String, String>,
}

/// Writes `model` and its configuration to `path`, atomically.
pub fn save<M: Module>(path: &Path, model: &M, config: &Config, meta: &Meta) -> Result<(), CheckpointError> {
    let config =
        config.to_toml().map_err(|source| CheckpointError::Config { path: path.to_owned(), source })?;
    let mut metadata = meta.extra.clone();
    metadata.insert("format_version".into(), FORMAT_VERSION.into());
    metadata.insert("step".into(), meta.step.to_string());
    metadata.insert("config".into(), config);
    TensorFile { tensors: tensors_of(model, path)?, metadata }.write(path)
}

/// Reads a network, its configuration and the rest of the metadata. Official states are read, too: their configuration is
/// the `config.json` beside them, else the release's with the sizes of the tensors.
pub fn load(path: &Path, device: &Device) -> Result<(UnoPose, Config, Meta), CheckpointError> {
    if official::is_official(path) {
        let state = OfficialState::read(path)?;
        let config = state.config()?;
        state.report();
        return Ok((state.into_model(&config.model, device)?, config, Meta::default()));
    }
    from_file(TensorFile::read(path)?, path, device)
}

/// The network of `config` with the weights of `path`, a checkpoint or an official state.
pub fn load_weights(path: &Path, config: &Config, device: &Device) -> Result<UnoPose, CheckpointError> {
    if official::is_official(path) {
        let state = OfficialState::read(path)?;
        state.report();
        return state.into_model(&config.model, device);
    }
    Ok(load_into(path, UnoPose::new(&config.model, config.seed, device), &config.model)?.0)
}

/// [`load`] from the bytes of a checkpoint; `name` is only for messages.
pub fn load_bytes(
    bytes: &[u8],
    name: &str,
    device: &Device,
) -> Result<(UnoPose, Config, Meta), CheckpointError> {
    let path = Path::new(name);
    from_file(TensorFile::from_bytes(bytes, path)?, path, device)
}

/// The proposal network in the bytes of a checkpoint, its configuration and the rest of the metadata; `name` is only for
/// messages. Weights of any other kind are listed as missing and unknown tensors.
pub fn load_proposals(
    bytes: &[u8],
    name: &str,
    device: &Device,
) -> Result<(ProposalNetwork, Config, Meta), CheckpointError> {
    let path = Path::new(name);
    let file = TensorFile::from_bytes(bytes, path)?;
    let config =
        config_of(&file, path)?.ok_or_else(|| metadata_error(path, "config", "absent", "a configuration"))?;
    let meta = meta_of(&file, path)?;
    let network = ProposalNetwork::new(&config.proposals, config.seed, device);
    Ok((fill(network, file, path, None)?, config, meta))
}

fn from_file(
    file: TensorFile,
    path: &Path,
    device: &Device,
) -> Result<(UnoPose, Config, Meta), CheckpointError> {
    let config =
        config_of(&file, path)?.ok_or_else(|| metadata_error(path, "config", "absent", "a configuration"))?;
    let meta = meta_of(&file, path)?;
    if file.metadata.contains_key(without_backbone::KEY) {
        return Err(CheckpointError::NeedsBackbone { path: path.to_owned() });
    }
    let model = fill(UnoPose::new(&config.model, config.seed, device), file, path, Some(&config.model))?;
    Ok((model, config, meta))
}

/// Fills `model`, which was made from `config`, with the weights of `path`.
pub fn load_into<M: Module>(
    path: &Path,
    model: M,
    config: &ModelConfig,
) -> Result<(M, Meta), CheckpointError> {
    let file = TensorFile::read(path)?;
    let meta = meta_of(&file, path)?;
    Ok((fill(model, file, path, Some(config))?, meta))
}

/// Start of the names of the colour encoder's tensors.
const ENCODER: &str = "feature_extraction.";

/// `model`, which was made from `config`, with the colour encoder of a checkpoint: of a distillation, or of a whole network.
pub fn load_encoder(
    path: &Path,
    config: &ModelConfig,
    mut model: UnoPose,
) -> Result<UnoPose, CheckpointError> {
    let mut file = TensorFile::read(path)?;
    meta_of(&file, path)?;
    let of_encoder =
        |(name, data): (String, TensorData)| Some((name.strip_prefix(ENCODER)?.to_owned(), data));
    file.tensors = file.tensors.into_iter().filter_map(of_encoder).collect();
    model.feature_extraction = fill(model.feature_extraction, file, path, Some(config))?;
    Ok(model)
}

/// `model`, which was made from `config`, with the weights of a whole network's checkpoint in all parts but the colour encoder.
pub fn load_except_encoder(
    path: &Path,
    config: &ModelConfig,
    model: UnoPose,
) -> Result<UnoPose, CheckpointError> {
    let mut file = TensorFile::read(path)?;
    meta_of(&file, path)?;
    file.tensors.retain(|name, _| !name.starts_with(ENCODER));
    let own = tensors_of(&model, path)?;
    file.tensors.extend(own.into_iter().filter(|(name, _)| name.starts_with(ENCODER)));
    fill(model, file, path, Some(config))
}

/// The metadata of a checkpoint that this program wrote.
pub fn read_meta(path: &Path) -> Result<Meta, CheckpointError> {
    meta_of(&TensorFile::read(path)?, path)
}

/// The value of a metadata entry that holds JSON, `None` where the checkpoint has no such entry. `expected` says in a message
/// what it should be.
pub fn metadata_value<T: serde::de::DeserializeOwned>(
    metadata: &BTreeMap<String, String>,
    key: &'static str,
    path: &Path,
    expected: &str,
) -> Result<Option<T>, CheckpointError> {
    let Some(text) = metadata.get(key) else { return Ok(None) };
    let read = serde_json::from_str(text);
    read.map(Some).map_err(|error| metadata_error(path, key, text, &format!("{expected} ({error})")))
}

/// Sets entries of a checkpoint's metadata and writes the file to `output` (which may be `path`).
pub fn annotate(
    path: &Path,
    output: &Path,
    entries: impl IntoIterator<Item = (String, String)>,
) -> Result<(), CheckpointError> {
    let mut file = TensorFile::read(path)?;
    meta_of(&file, path)?;
    file.metadata.extend(entries);
    file.write(output)
}

/// The metadata entry that holds a configuration, for [`annotate`].
pub fn config_entry(config: &Config) -> Result<(String, String), ConfigError> {
    Ok(("config".into(), config.to_toml()?))
}

/// The configuration inside a checkpoint.
pub fn read_config(path: &Path) -> Result<Config, CheckpointError> {
    config_of(&TensorFile::read(path)?, path)?
        .ok_or_else(|| metadata_error(path, "config", "absent", "a configuration"))
}

fn fill<M: Module>(
    model: M,
    file: TensorFile,
    path: &Path,
    ours: Option<&ModelConfig>,
) -> Result<M, CheckpointError> {
    // The configuration inside explains the tensors; a file without a readable one is judged by them alone.
    let theirs = ours.and_then(|ours| Some((ours, config_of(&file, path).ok()??.model)));
    // Statistics of a forward pass that are still to be merged would overwrite the loaded ones: merge them now.
    drop(model.valid());
    fill_with(model, file.tensors, path).map_err(|error| match (error, theirs) {
        (CheckpointError::Mismatch { path, mut mismatch }, Some((ours, theirs))) => {
            mismatch.config = differences(&theirs, ours);
            CheckpointError::Mismatch { path, mismatch }
        }
        (error, _) => error,
    })
}

/// `model` with exactly these tensors. Every missing, unknown and wrongly shaped one is listed in the error; parameters
/// that do not exist yet are not made first.
pub fn fill_with<M: Module>(
    mut model: M,
    tensors: BTreeMap<String, TensorData>,
    path: &Path,
) -> Result<M, CheckpointError> {
    let own = state_shapes(&model);
    let mut mismatch = Mismatch {
        missing: own.keys().filter(|name| !tensors.contains_key(*name)).cloned().collect(),
        ..Mismatch::default()
    };
    for (name, data) in &tensors {
        match own.get(name) {
            None => mismatch.extra.push(name.clone()),
            Some(shape) if shape[..] != data.shape()[..] => {
                mismatch.shapes.push((name.clone(), data.shape().to_vec(), shape.clone()));
            }
            Some(_) => {}
        }
    }
    if !mismatch.fits() {
        return Err(CheckpointError::Mismatch { path: path.to_owned(), mismatch: Box::new(mismatch) });
    }
    let tensors = tensors.into_iter().map(|(name, data)| bridge::from_data(data, name, None)).collect();
    let result = model.apply(tensors, None, Some(Box::new(PyTorchToBurnAdapter)), true);
    match result.errors.first() {
        Some(error) => Err(CheckpointError::Format { path: path.to_owned(), message: error.to_string() }),
        None => Ok(model),
    }
}

/// All parameters and buffers under their official names and in their official layouts, on the host.
fn tensors_of<M: Module>(model: &M, path: &Path) -> Result<BTreeMap<String, TensorData>, CheckpointError> {
    // Batch statistics of the last forward pass are only merged on demand; `valid` demands it.
    model
        .valid()
        .collect(None, Some(Box::new(BurnToPyTorchAdapter)), true)
        .into_iter()
        .map(|tensor| {
            let name = tensor.name.clone();
            match bridge::into_data(tensor) {
                Ok(data) => Ok((name, data.convert::<f32>())),
                Err(e) => {
                    Err(CheckpointError::Tensor { path: path.to_owned(), name, message: e.to_string() })
                }
            }
        })
        .collect()
}

/// All parameters and buffers of a network on the host, under their official names and in PyTorch layouts.
pub fn official_tensors<M: Module>(model: &M) -> Result<BTreeMap<String, TensorData>, CheckpointError> {
    tensors_of(model, Path::new("the network"))
}

/// CRC-32 of the names and values of all parameters and buffers: equal for equal weights, wherever they come from.
pub fn checksum<M: Module>(model: &M) -> Result<u32, CheckpointError> {
    Ok(checksum_of(&official_tensors(model)?))
}

/// CRC-32 of names and values.
pub fn checksum_of(tensors: &BTreeMap<String, TensorData>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    for (name, data) in tensors {
        hasher.update(name.as_bytes());
        hasher.update(data.as_bytes());
    }
    hasher.finalize()
}

fn config_of(file: &TensorFile, path: &Path) -> Result<Option<Config>, CheckpointError> {
    let parse = |text: &String| Config::from_toml(text, path, &[]);
    let config = file.metadata.get("config").map(parse).transpose();
    config.map_err(|source| CheckpointError::Config { path: path.to_owned(), source })
}

fn meta_of(file: &TensorFile, path: &Path) -> Result<Meta, CheckpointError> {
    let mut extra = file.metadata.clone();
    extra.remove("config");
    let version = extra.remove("format_version").unwrap_or_else(|| "absent".into());
    if version != FORMAT_VERSION {
        return Err(metadata_error(path, "format_version", &version, FORMAT_VERSION));
    }
    let step = extra.remove("step").unwrap_or_else(|| "absent".into());
    let step = step.parse().map_err(|_| metadata_error(path, "step", &step, "a number of steps"))?;
    Ok(Meta { step, extra })
}

fn metadata_error(path: &Path, key: &'static str, value: &str, expected: &str) -> CheckpointError {
    CheckpointError::Metadata { path: path.to_owned(), key, value: value.into(), expected: expected.into() }
}

/// Fields in which two model configurations differ: path, theirs, ours.
pub fn differences(theirs: &ModelConfig, ours: &ModelConfig) -> Vec<(String, String, String)> {
    let mut found = Vec::new();
    if let (Ok(theirs), Ok(ours)) = (toml::Value::try_from(theirs), toml::Value::try_from(ours)) {
        compare("model", Some(&theirs), Some(&ours), &mut found);
    }
    found
}

fn compare(
    path: &str,
    theirs: Option<&toml::Value>,
    ours: Option<&toml::Value>,
    found: &mut Vec<(String, String, String)>,
) {
    if let (Some(toml::Value::Table(theirs)), Some(toml::Value::Table(ours))) = (theirs, ours) {
        let keys: std::collections::BTreeSet<&String> = theirs.keys().chain(ours.keys()).collect();
        for key in keys {
            compare(&format!("{path}.{key}"), theirs.get(key), ours.get(key), found);
        }
    } else if theirs != ours {
        let text = |value: Option<&toml::Value>| value.map_or("absent".into(), ToString::to_string);
        found.push((path.into(), text(theirs), text(ours)));
    }
}

#[cfg(test)]
mod tests;
