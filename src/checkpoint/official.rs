//! Weights of the official PyTorch release: the same names, convolutions with explicit unit kernels, and a few tensors
//! that nothing reads.

use std::path::Path;

use burn::tensor::{Device, TensorData};

use super::{CheckpointError, TensorFile, fill};
use crate::{config::ModelConfig, model::UnoPose};

/// State names that the release stores but never uses (or recomputes), by suffix or prefix.
const UNUSED: [&str; 5] = [
    "feature_extraction.rgb_net.vit.head.",
    "fine_point_matching.dis_proj.",
    "geo_embedding.embedding.div_term",
    ".num_batches_tracked",
    ".mask_token",
];

/// Reads a safetensors file with official names into a fresh network of `config`. Also returns the names of stored
/// tensors that the network does not use.
pub fn load_official(
    path: &Path,
    config: &ModelConfig,
    device: &Device,
) -> Result<(UnoPose, Vec<String>), CheckpointError> {
    let (mut file, unused) = TensorFile::read_without(path, |name| UNUSED.iter().any(|u| name.contains(u)))?;
    for (name, data) in &mut file.tensors {
        // 1x1 convolutions are linear layers here.
        let [output, input, rest @ ..] = &data.shape()[..] else { continue };
        if name.contains(".PE.") && !rest.is_empty() && rest.iter().all(|&n| n == 1) {
            let shape = [*output, *input];
            *data = TensorData::from_bytes_vec(data.as_bytes().to_vec(), shape, data.dtype());
        }
    }
    let model = fill(UnoPose::new(config, 0, device), file, path, None)?;
    Ok((model, unused))
}
