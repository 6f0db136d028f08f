//! Published files of Segment Anything: `sam_vit_{b,l,h}_*.pth`, `mobile_sam.pt`, or the same tensors as safetensors.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use burn::tensor::{Device, TensorData};
use unopose_nn::checkpoint::{
    CheckpointError, Layout, Mismatch, NamedTensors, checksum_of, contents, fill_with,
};

use super::{
    network::Sam,
    sizes::{SamSizes, Shapes, SizeError},
};

/// The parts of a network and the prefixes under which files hold them.
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

/// A published file: its tensors and the sizes read off their shapes.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SamCheckpoint {
    path: PathBuf,
    /// Sizes of the network in the file.
    pub sizes: SamSizes,
    /// Parameters and buffers as f32 under their published names.
    pub tensors: BTreeMap<String, TensorData>,
    /// Names of stored tensors that the network does not use.
    pub unused: Vec<String>,
    /// Conversions and omissions, one sentence each.
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

    /// Logs the notices and the names of unused tensors.
    pub fn log_notices(&self) {
        let path = self.path.display();
        self.notices.iter().for_each(|notice| tracing::warn!("{path}: {notice}"));
        if !self.unused.is_empty() {
            tracing::info!("{path}: stored but not used: {}", self.unused.join(", "));
        }
    }

    /// CRC-32 of names and values.
    pub fn checksum(&self) -> u32 {
        checksum_of(&self.tensors)
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

#[cfg(test)]
mod tests {
    use unopose_nn::checkpoint::state_shapes;

    use super::*;
    use crate::sam::sizes::EncoderSizes;

    /// Names and shapes of the published networks, by the names that their authors give them.
    fn published() -> BTreeMap<&'static str, Shapes> {
        let text = include_str!("states.txt");
        let mut states: BTreeMap<&str, Shapes> = BTreeMap::new();
        let mut network = "";
        for line in text.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("#") => network = words.next().unwrap(),
                Some(name) => {
                    let shape = words.map(|n| n.parse().unwrap()).collect();
                    states.entry(network).or_default().insert(name.into(), shape);
                }
                None => {}
            }
        }
        states
    }

    #[test]
    fn networks_have_the_published_names_and_shapes() {
        for (network, name, heads, windowed) in [
            ("vit_b", "SAM ViT-B", 12, vec![2, 5, 8, 11]),
            ("vit_l", "SAM ViT-L", 16, vec![5, 11, 17, 23]),
            ("vit_h", "SAM ViT-H", 16, vec![7, 15, 23, 31]),
            ("vit_t", "MobileSAM", 0, vec![]),
        ] {
            let mut shapes = published().remove(network).unwrap();
            let all = shapes.len();
            shapes.retain(|name, _| !UNUSED.iter().any(|part| name.contains(part)));
            assert!(all > shapes.len() + 9, "{network}: {all} {}", shapes.len());
            let sizes = SamSizes::of(&shapes).unwrap();
            assert_eq!((sizes.published(), sizes.image_size), (Some(name), 1024));
            match &sizes.encoder {
                EncoderSizes::Vit(vit) => {
                    assert_eq!((vit.heads, vit.patch_size), (heads, 16));
                    for (block, window) in vit.windows.iter().enumerate() {
                        let expected = (!windowed.contains(&block)).then_some(14);
                        assert_eq!(*window, expected, "{network} block {block}");
                    }
                }
                EncoderSizes::TinyVit(tiny) => {
                    let stages: Vec<_> =
                        tiny.attentions.iter().map(|a| (a.stage.depth, a.heads, a.window)).collect();
                    assert_eq!(stages, [(2, 4, 7), (6, 5, 14), (2, 10, 7)]);
                }
            }
            // No parameter is made: the largest network would take 2.5 GB.
            assert_eq!(state_shapes(&Sam::new(&sizes, &Device::default())), shapes, "{network}");
        }
    }

    #[test]
    fn sizes_that_contradict_each_other_are_refused_by_name() {
        let error = |change: &dyn Fn(&mut Shapes)| {
            let mut shapes = published().remove("vit_b").unwrap();
            change(&mut shapes);
            let error = SamSizes::of(&shapes).unwrap_err();
            refused(Path::new("sam.pth"), &shapes, error).to_string()
        };
        let block = "image_encoder.blocks.3.attn.rel_pos_h";
        let message = error(&|shapes| drop(shapes.remove(block)));
        assert!(message.contains(&format!("{block} is missing")), "{message}");
        let message = error(&|shapes| drop(shapes.insert(block.into(), vec![28, 64])));
        assert!(message.contains(&format!("{block}: shape is [28, 64]")), "{message}");
        let message =
            error(&|shapes| drop(shapes.insert("mask_decoder.mask_tokens.weight".into(), vec![4, 250])));
        assert!(message.contains("mask_tokens.weight: shape is [4, 250]"), "{message}");
        let message = error(&|shapes| shapes.retain(|name, _| name.starts_with("prompt_encoder.")));
        let first = "prompt_encoder.mask_downscaling.0.bias [4]";
        assert!(message.contains("no Segment Anything network") && message.contains(first), "{message}");
    }
}
