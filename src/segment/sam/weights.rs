//! Published files of Segment Anything: `sam_vit_{b,l,h}_*.pth`, `mobile_sam.pt`, or the same tensors as safetensors.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use burn::tensor::{Device, TensorData};

use super::{
    network::Sam,
    sizes::{SamSizes, Shapes, SizeError},
};
use crate::checkpoint::{CheckpointError, Layout, Mismatch, NamedTensors, contents, fill_with};

const LAYOUT: Layout = Layout {
    parts: &["image_encoder.", "prompt_encoder.", "mask_decoder."],
    places: &["", "model.", "state_dict.", "module.", "sam."],
};

/// Stored tensors that no proposal needs, by a part of the name: prompts by masks are not given, MobileSAM's classifier is
/// a remnant of its training, and the rest are counters and indices.
const UNUSED: [&str; 6] = [
    "prompt_encoder.mask_downscaling.",
    "image_encoder.norm_head.",
    "image_encoder.head.",
    ".num_batches_tracked",
    ".attention_bias_idxs",
    ".attn.ab",
];

/// The tensors of a file and what they tell.
#[derive(Clone, Debug)]
pub struct SamCheckpoint {
    path: PathBuf,
    pub sizes: SamSizes,
    /// Parameters and buffers as f32 under their published names.
    pub tensors: BTreeMap<String, TensorData>,
    /// Names of stored tensors that the network does not use.
    pub unused: Vec<String>,
    /// Conversions and what was left out, one sentence each.
    pub notices: Vec<String>,
}

impl SamCheckpoint {
    /// Reads the network in a file; `None` when the file holds something else.
    pub fn read(path: &Path) -> Result<Option<Self>, CheckpointError> {
        let Some(named) = NamedTensors::read(path, &LAYOUT, &UNUSED)? else { return Ok(None) };
        let shapes: Shapes = named.tensors.iter().map(|(n, t)| (n.clone(), t.shape().to_vec())).collect();
        let sizes = SamSizes::of(&shapes).map_err(|error| refused(path, &shapes, error))?;
        let NamedTensors { tensors, unused, notices } = named;
        Ok(Some(Self { path: path.to_owned(), sizes, tensors, unused, notices }))
    }

    /// [`Self::read`] of a file that must hold such a network.
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        match Self::read(path)? {
            Some(checkpoint) => Ok(checkpoint),
            None => Err(CheckpointError::NoSam { path: path.to_owned(), found: contents(path)? }),
        }
    }

    /// The network with these weights. Every missing, unknown and wrongly shaped tensor is listed in the error.
    pub fn into_network(self, device: &Device) -> Result<Sam, CheckpointError> {
        fill_with(Sam::new(&self.sizes, device), self.tensors, &self.path)
    }

    /// Notices go to the log.
    pub fn report(&self) {
        let path = self.path.display();
        self.notices.iter().for_each(|notice| tracing::warn!("{path}: {notice}"));
        if !self.unused.is_empty() {
            tracing::info!("{path}: stored but not used: {}", self.unused.join(", "));
        }
    }

    /// CRC-32 of names and values.
    pub fn checksum(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for (name, data) in &self.tensors {
            hasher.update(name.as_bytes());
            hasher.update(data.as_bytes());
        }
        hasher.finalize()
    }
}

fn refused(path: &Path, shapes: &Shapes, error: SizeError) -> CheckpointError {
    let path = path.to_owned();
    match error {
        SizeError::Encoder => {
            let first = shapes.iter().next().map(|(name, shape)| format!("{name} {shape:?}"));
            let found = format!("{} tensors, the first is {}", shapes.len(), first.unwrap_or_default());
            CheckpointError::NoSam { path, found }
        }
        SizeError::Missing(name) => {
            let mismatch = Mismatch { missing: vec![name], ..Mismatch::default() };
            CheckpointError::Mismatch { path, mismatch: Box::new(mismatch) }
        }
        SizeError::Shape { name, shape, expected } => CheckpointError::Tensor {
            path,
            name,
            message: format!("shape is {shape:?}, expected {expected}"),
        },
    }
}
