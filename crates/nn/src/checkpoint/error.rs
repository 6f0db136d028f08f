//! Why a checkpoint was refused.

use std::{fmt, path::PathBuf};

use unopose_core::{config::ConfigError, files::FileError};

/// A checkpoint that cannot be written, read, or put into the network at hand.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // Each message says what is wrong.
pub enum CheckpointError {
    #[error("cannot read checkpoint {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Write(#[from] FileError),
    #[error("{} is not a safetensors file: {message}", path.display())]
    Format { path: PathBuf, message: String },
    #[error(
        "{} is damaged: its checksum is {stored}, but that of its contents is {computed}; copy or train it again",
        path.display()
    )]
    Damaged { path: PathBuf, stored: String, computed: String },
    #[error("{} is neither a safetensors file nor a readable PyTorch checkpoint: {message}", path.display())]
    Pytorch { path: PathBuf, message: String },
    #[error(
        "{} has no state of the network at its top level or under model or state_dict, expected names like \
         coarse_point_matching.in_proj.weight; found {found}", path.display()
    )]
    NoNetwork { path: PathBuf, found: String },
    #[error(
        "{} holds no DINOv2 backbone: no patch_embed.proj.weight (Meta, timm) or \
         embeddings.patch_embeddings.projection.weight (Hugging Face); found {found}", path.display()
    )]
    NoBackbone { path: PathBuf, found: String },
    #[error(
        "{} holds no Segment Anything network (image_encoder.*, prompt_encoder.* and mask_decoder.* as in sam_vit_*.pth or \
         mobile_sam.pt); found {found}", path.display()
    )]
    NoSam { path: PathBuf, found: String },
    #[error(
        "{} is a backbone with SwiGLU feed-forward layers ({name}), as DINOv2's ViT-g; ViT-S, ViT-B and ViT-L can be used",
        path.display()
    )]
    SwiGlu { path: PathBuf, name: String },
    #[error("{} is a vision transformer, but model.color.kind is not vit", path.display())]
    NoTransformer { path: PathBuf },
    #[error(
        "{} was written without its backbone; name the DINOv2 weights that it was trained with by --backbone",
        path.display()
    )]
    NeedsBackbone { path: PathBuf },
    #[error(
        "{} gives other features than the backbone that {} was trained with", backbone.display(), path.display()
    )]
    OtherBackbone { path: PathBuf, backbone: PathBuf },
    #[error(
        "{}: nothing tells the number of heads of a transformer {width} wide (DINOv2 has width / 64); put the official \
         config.json beside the file",
        path.display()
    )]
    Heads { path: PathBuf, width: usize },
    #[error("this network cannot be written in the official form: {reason}")]
    NoCounterpart { reason: String },
    #[error("{}: metadata {key} is {value}, expected {expected}", path.display())]
    Metadata { path: PathBuf, key: &'static str, value: String, expected: String },
    #[error("{}: the configuration inside cannot be used: {source}", path.display())]
    Config { path: PathBuf, source: ConfigError },
    #[error("{} does not fit this network: {mismatch}", path.display())]
    Mismatch { path: PathBuf, mismatch: Box<Mismatch> },
    #[error("{}: tensor {name}: {message}", path.display())]
    Tensor { path: PathBuf, name: String, message: String },
}

/// Every difference between a checkpoint's tensors and the network's.
#[derive(Debug, Default)]
pub struct Mismatch {
    /// Configuration fields that differ: path, value in the checkpoint, value here.
    pub config: Vec<(String, String, String)>,
    /// Tensors of the network that the checkpoint lacks.
    pub missing: Vec<String>,
    /// Tensors of the checkpoint that the network lacks.
    pub extra: Vec<String>,
    /// Name, shape in the checkpoint, shape in the network.
    pub shapes: Vec<(String, Vec<usize>, Vec<usize>)>,
}

impl Mismatch {
    /// Whether every tensor has its place; the configuration may differ.
    pub fn fits(&self) -> bool {
        self.missing.is_empty() && self.extra.is_empty() && self.shapes.is_empty()
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines: Vec<String> = self
            .config
            .iter()
            .map(|(field, theirs, ours)| format!("{field} is {theirs} in the checkpoint, {ours} here"))
            .collect();
        let shapes = self.shapes.iter().map(|(name, theirs, ours)| {
            format!("{name} has shape {theirs:?} in the checkpoint, {ours:?} in the network")
        });
        lines.extend(shapes);
        lines.extend(self.missing.iter().map(|name| format!("{name} is missing in the checkpoint")));
        lines.extend(self.extra.iter().map(|name| format!("{name} is unknown to the network")));
        write!(f, "{}", lines.join("; "))
    }
}
