//! Weights of the official PyTorch release: the same names, convolutions with explicit unit kernels, and a few tensors
//! that nothing reads. Read from safetensors or from PyTorch's own files, whatever the file is called.

mod export;
mod sizes;

pub use export::export_official;
pub use sizes::OfficialSizes;

use std::{
    collections::BTreeMap,
    io::Read as _,
    path::{Path, PathBuf},
};

use burn::tensor::{DType, Device, TensorData};
use safetensors::SafeTensors;
use unopose_core::config::{Config, ModelConfig};

use super::{
    CheckpointError, TensorFile,
    file::as_f32,
    fill,
    stored::{Container, Layout, Stored},
};
use crate::model::UnoPose;

/// State names that the release stores but never uses (or recomputes), by a part of the name.
const UNUSED: [&str; 5] = [
    "feature_extraction.rgb_net.vit.head.",
    "fine_point_matching.dis_proj.",
    "geo_embedding.embedding.div_term",
    ".num_batches_tracked",
    ".mask_token",
];

const LAYOUT: Layout = Layout {
    parts: &["feature_extraction.", "geo_embedding.", "coarse_point_matching.", "fine_point_matching."],
    places: &[
        "",
        "model.",
        "state_dict.",
        "model_state_dict.",
        "module.",
        "model.module.",
        "state_dict.module.",
    ],
};

/// Buffers that count the batches a BatchNorm has seen.
const BATCHES_TRACKED: &str = ".num_batches_tracked";

/// The network's share of an official file, on the host.
#[derive(Clone, Debug)]
pub struct OfficialState {
    path: PathBuf,
    /// Parameters and buffers as f32 under their official names.
    pub tensors: BTreeMap<String, TensorData>,
    /// Names of stored tensors that the network does not use.
    pub unused: Vec<String>,
    /// Conversions and everything that was left out, one sentence each.
    pub notices: Vec<String>,
    /// Batches seen by each BatchNorm, by the name of the buffer.
    pub batches_tracked: BTreeMap<String, i64>,
}

impl OfficialState {
    /// Reads a safetensors file or a PyTorch file; the content decides which, not the name. Half and double precision
    /// become f32, with a notice.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let container = Container::open(path)?;
        let Some(place) = container.place(path, &LAYOUT)? else {
            return Err(CheckpointError::NoNetwork {
                path: path.to_owned(),
                found: container.describe(path),
            });
        };
        let (stored, mut notices) = container.read(path, place)?;
        let (mut tensors, mut unused, mut batches_tracked) = (BTreeMap::new(), Vec::new(), BTreeMap::new());
        let mut converted: BTreeMap<String, usize> = BTreeMap::new();
        for Stored { name, shape, dtype, bytes } in stored {
            if UNUSED.iter().any(|part| name.contains(part)) {
                if let (true, Some(count)) = (name.ends_with(BATCHES_TRACKED), bytes.first_chunk::<8>()) {
                    batches_tracked.insert(name.clone(), i64::from_le_bytes(*count));
                }
                unused.push(name);
                continue;
            }
            if dtype != DType::F32 {
                *converted.entry(format!("{dtype:?}")).or_default() += 1;
            }
            let data = as_f32(path, &name, bytes, shape, dtype)?;
            tensors.insert(name, data);
        }
        notices
            .extend(converted.iter().map(|(dtype, n)| format!("{n} tensors converted from {dtype} to F32")));
        unused.sort();
        Ok(Self { path: path.to_owned(), tensors, unused, notices, batches_tracked })
    }

    /// The sizes that the shapes tell.
    pub fn sizes(&self) -> OfficialSizes {
        OfficialSizes::of(&self.tensors)
    }

    /// The configuration that goes with these weights: `config.json` beside the file, else the release's behaviour with
    /// the sizes of the tensors.
    pub fn config(&self) -> Result<Config, CheckpointError> {
        let refused = |source| CheckpointError::Config { path: self.path.clone(), source };
        let beside = self.path.with_file_name("config.json");
        if beside.is_file() {
            return Config::load_official(&beside).map_err(refused);
        }
        let mut config = Config::embedded("unopose", &[]).map_err(refused)?;
        self.sizes().apply(&mut config.model);
        match self.sizes().vit_embed_dim {
            // DINOv2's heads have 64 channels; a transformer of another width is none of its.
            Some(width) if !width.is_multiple_of(64) => {
                Err(CheckpointError::Heads { path: self.path.clone(), width })
            }
            _ => Ok(config),
        }
    }

    /// Writes conversions and the names of unused tensors to the log.
    pub fn report(&self) {
        let path = self.path.display();
        self.notices.iter().for_each(|notice| tracing::warn!("{path}: {notice}"));
        if !self.unused.is_empty() {
            tracing::warn!("{path}: stored but not used: {}", self.unused.join(", "));
        }
    }

    /// A network of `config` with these weights. Every missing, extra and wrongly shaped tensor is listed in the error.
    pub fn into_model(mut self, config: &ModelConfig, device: &Device) -> Result<UnoPose, CheckpointError> {
        let differences = self.sizes().differences(config);
        for (name, data) in &mut self.tensors {
            // 1x1 convolutions are linear layers here.
            let [output, input, rest @ ..] = &data.shape()[..] else { continue };
            if name.contains(".PE.") && !rest.is_empty() && rest.iter().all(|&n| n == 1) {
                let shape = [*output, *input];
                *data = TensorData::from_bytes_vec(data.as_bytes().to_vec(), shape, data.dtype());
            }
        }
        let file = TensorFile { tensors: self.tensors, metadata: BTreeMap::new() };
        fill(UnoPose::new(config, 0, device), file, &self.path, None).map_err(|error| match error {
            CheckpointError::Mismatch { path, mut mismatch } => {
                mismatch.config = differences;
                CheckpointError::Mismatch { path, mismatch }
            }
            other => other,
        })
    }
}

/// Whether a file is to be read as an official state: a PyTorch file, or safetensors with its names that this program has
/// not written.
pub(super) fn is_official(path: &Path) -> bool {
    let Ok(container) = Container::open(path) else { return is_pytorch(path) };
    match &container {
        Container::Pickled(..) => true,
        Container::Safetensors(bytes) => {
            let metadata = SafeTensors::read_metadata(bytes).map(|(_, header)| header.metadata().clone());
            let ours = metadata.is_ok_and(|m| m.is_some_and(|m| m.contains_key("format_version")));
            !ours && container.place(path, &LAYOUT).is_ok_and(|place| place.is_some())
        }
    }
}

/// Whether a file, damaged or not, begins as `torch.save` writes it.
fn is_pytorch(path: &Path) -> bool {
    let mut start = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && (start == *b"PK\x03\x04" || start[0] == 0x80)
}

/// [`OfficialState::read`] into a fresh network of `config`. Also returns the names of stored tensors that the network
/// does not use; notices go to the log.
pub fn load_official(
    path: &Path,
    config: &ModelConfig,
    device: &Device,
) -> Result<(UnoPose, Vec<String>), CheckpointError> {
    let state = OfficialState::read(path)?;
    state.report();
    let unused = state.unused.clone();
    Ok((state.into_model(config, device)?, unused))
}
