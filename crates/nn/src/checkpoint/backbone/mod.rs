//! DINOv2 backbones as their distributors publish them: three namings, with and without registers, safetensors or
//! PyTorch files, at any resolution of the position embedding.
//!
//! Only what the vision transformer of [`crate::model`] can hold is read: ViT-S, B and L with plain feed-forward layers.
//! ViT-g has SwiGLU layers and is refused.

mod naming;
mod network;
mod position;

pub use naming::Naming;
pub use network::{load_backbone, load_transformer};
pub use position::Resampling;

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

use burn::tensor::{DType, TensorData};

use super::{CheckpointError, Mismatch, TensorFile, file::as_f32, fill, stored};
use naming::Target;
use stored::{Container, Layout, Stored};

const LAYOUT: Layout = Layout {
    parts: &["patch_embed.", "pos_embed", "embeddings.patch_embeddings.", "embeddings.position_embeddings"],
    places: &[
        "",
        "model.",
        "state_dict.",
        "module.",
        "backbone.",
        "teacher.backbone.",
        "dinov2.",
        "dinov2_with_registers.",
    ],
};

/// Widths of ViT-S, B, L, whose heads have 64 channels.
const PUBLISHED: [(usize, usize, &str); 3] = [(384, 12, "ViT-S"), (768, 12, "ViT-B"), (1024, 24, "ViT-L")];

/// A backbone on the host, under our names.
#[derive(Clone, Debug)]
pub struct Backbone {
    path: PathBuf,
    /// Whose names the file uses.
    pub naming: Naming,
    /// Parameters as f32; the position embedding as it is stored.
    pub tensors: BTreeMap<String, TensorData>,
    /// Names of stored tensors that the network does not use.
    pub unused: Vec<String>,
    /// Names that this naming does not have.
    pub unknown: Vec<String>,
    /// Joint projections of which the file has a part: the names of the other parts.
    incomplete: BTreeMap<String, Vec<String>>,
    /// Conversions and what was left out, one sentence each.
    pub notices: Vec<String>,
}

/// What the shapes of a backbone tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackboneSizes {
    /// Width of the tokens.
    pub embed_dim: usize,
    /// Number of blocks.
    pub depth: usize,
    /// Side of a patch, pixels.
    pub patch_size: usize,
    /// Tokens beside the class token and the patches.
    pub register_tokens: usize,
    /// Patches per side of the position embedding.
    pub side: usize,
    /// The position embedding has an entry for the class token.
    pub class_position: bool,
}

impl Backbone {
    /// Reads the backbone in a file; `None` when the file holds something else.
    pub fn read(path: &Path) -> Result<Option<Self>, CheckpointError> {
        match Self::open(path) {
            Err(CheckpointError::NoBackbone { .. }) => Ok(None),
            read => read.map(Some),
        }
    }

    /// Reads the backbone in a file that must hold one.
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        let container = Container::open(path)?;
        let Some(place) = container.place(path, &LAYOUT)? else {
            let found = container.describe(path);
            return Err(CheckpointError::NoBackbone { path: path.to_owned(), found });
        };
        let (stored, notices) = container.read(path, place)?;
        let naming = Naming::of(stored.iter().map(|tensor| tensor.name.as_str()));
        let mut backbone = Self {
            path: path.to_owned(),
            naming,
            tensors: BTreeMap::new(),
            unused: Vec::new(),
            unknown: Vec::new(),
            incomplete: BTreeMap::new(),
            notices,
        };
        backbone.take(stored)?;
        Ok(backbone)
    }

    fn take(&mut self, stored: Vec<Stored>) -> Result<(), CheckpointError> {
        let mut thirds: BTreeMap<String, [Option<TensorData>; 3]> = BTreeMap::new();
        let mut converted: BTreeMap<String, usize> = BTreeMap::new();
        for Stored { name, shape, dtype, bytes } in stored {
            let floats = |name: &str| {
                if dtype != DType::F32 {
                    *converted.entry(format!("{dtype:?}")).or_default() += 1;
                }
                as_f32(&self.path, name, bytes, shape, dtype)
            };
            match self.naming.target(&name) {
                Target::Whole(ours) => {
                    let data = floats(&name)?;
                    self.tensors.insert(ours, data);
                }
                Target::Third(ours, part) => {
                    let data = floats(&name)?;
                    thirds.entry(ours).or_default()[part] = Some(data);
                }
                Target::SwiGlu => return Err(self.swiglu(&name)),
                Target::Unused => self.unused.push(name),
                Target::Unknown => self.unknown.push(name),
            }
        }
        for (ours, parts) in thirds {
            if let [Some(q), Some(k), Some(v)] = &parts {
                self.tensors.insert(ours, stacked([q, k, v]));
            } else {
                let absent = parts.iter().enumerate().filter(|(_, part)| part.is_none());
                let names = absent.map(|(part, _)| naming::name_of_third(&ours, part)).collect();
                self.incomplete.insert(ours, names);
            }
        }
        // timm stores SwiGLU under the names of the plain layers: the first is twice as wide as the second expects.
        for (name, first) in &self.tensors {
            let Some(block) = name.strip_suffix("mlp.fc1.weight") else { continue };
            let second = self.tensors.get(&format!("{block}mlp.fc2.weight"));
            let (wide, inner) = (first.shape().first(), second.and_then(|t| t.shape().get(1)));
            if let (Some(&wide), Some(&inner)) = (wide, inner)
                && wide == 2 * inner
            {
                return Err(self.swiglu(name));
            }
        }
        self.notices
            .extend(converted.iter().map(|(dtype, n)| format!("{n} tensors converted from {dtype} to F32")));
        Ok(())
    }

    fn swiglu(&self, name: &str) -> CheckpointError {
        CheckpointError::SwiGlu { path: self.path.clone(), name: name.to_owned() }
    }

    /// The sizes that the shapes tell.
    pub fn sizes(&self) -> BackboneSizes {
        let axis = |name: &str, axis: usize| {
            self.tensors.get(name).and_then(|t| t.shape().get(axis).copied()).unwrap_or(0)
        };
        let block = |name: &String| name.strip_prefix("blocks.")?.split('.').next()?.parse::<usize>().ok();
        let positions = axis("pos_embed", 1);
        let side = positions.isqrt();
        BackboneSizes {
            embed_dim: axis("cls_token", 2),
            depth: self.tensors.keys().filter_map(block).max().map_or(0, |last| last + 1),
            patch_size: axis("patch_embed.proj.weight", 2),
            register_tokens: axis("reg_token", 1),
            side,
            // A square count of patches, or one more: 1 + 37 * 37.
            class_position: positions > 0 && side * side != positions,
        }
    }
}

/// Rows of three tensors one after the other.
fn stacked(parts: [&TensorData; 3]) -> TensorData {
    let rows = parts.iter().filter_map(|part| part.shape().first()).sum();
    let mut shape = parts[0].shape().to_vec();
    if let Some(first) = shape.first_mut() {
        *first = rows;
    }
    let bytes = parts.iter().flat_map(|part| part.as_bytes().iter().copied()).collect();
    TensorData::from_bytes_vec(bytes, shape, DType::F32)
}

impl fmt::Display for BackboneSizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let published =
            PUBLISHED.iter().find(|&&(width, depth, _)| (width, depth) == (self.embed_dim, self.depth));
        let name = published.map_or("a vision transformer", |&(.., name)| name);
        writeln!(f, "{name}/{}", self.patch_size)?;
        writeln!(f, "embed_dim: {}", self.embed_dim)?;
        writeln!(f, "depth: {}", self.depth)?;
        writeln!(f, "register_tokens: {}", self.register_tokens)?;
        let (side, pixels) = (self.side, self.side * self.patch_size);
        let class = if self.class_position { "with" } else { "without" };
        writeln!(f, "position embedding: {side} x {side} ({pixels} pixels), {class} the class token's")
    }
}
