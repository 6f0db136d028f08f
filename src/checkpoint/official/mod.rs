//! Weights of the official PyTorch release: the same names, convolutions with explicit unit kernels, and a few tensors
//! that nothing reads. Read from safetensors or from PyTorch's own files, whatever the file is called.

mod export;
mod sizes;
mod stored;

pub use export::export_official;
pub use sizes::OfficialSizes;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use burn::tensor::{DType, Device, TensorData};

use super::{CheckpointError, TensorFile, file::as_f32, fill};
use crate::{config::ModelConfig, model::UnoPose};
use stored::Stored;

/// State names that the release stores but never uses (or recomputes), by a part of the name.
const UNUSED: [&str; 5] = [
    "feature_extraction.rgb_net.vit.head.",
    "fine_point_matching.dis_proj.",
    "geo_embedding.embedding.div_term",
    ".num_batches_tracked",
    ".mask_token",
];

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
        let (stored, mut notices) = stored::read(path)?;
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

/// [`OfficialState::read`] into a fresh network of `config`. Also returns the names of stored tensors that the network
/// does not use; notices go to the log.
pub fn load_official(
    path: &Path,
    config: &ModelConfig,
    device: &Device,
) -> Result<(UnoPose, Vec<String>), CheckpointError> {
    let state = OfficialState::read(path)?;
    state.notices.iter().for_each(|notice| tracing::warn!("{}: {notice}", path.display()));
    let unused = state.unused.clone();
    Ok((state.into_model(config, device)?, unused))
}
