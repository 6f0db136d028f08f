//! Sizes of an official network, read off the shapes of its tensors.

use std::{collections::BTreeMap, fmt};

use burn::tensor::TensorData;
use unopose_core::config::{ColorConfig, ModelConfig, VitConfig};

/// What the shapes tell; `None` where the tensors are absent. Numbers of heads are not among it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OfficialSizes {
    /// Width of the backbone's tokens.
    pub vit_embed_dim: Option<usize>,
    /// Blocks of the backbone.
    pub vit_depth: Option<usize>,
    /// Side of a patch, pixels.
    pub vit_patch_size: Option<usize>,
    /// Register tokens of the backbone.
    pub vit_register_tokens: Option<usize>,
    /// Rows of the position embedding.
    pub vit_positions: Option<usize>,
    /// Channels of the colour features.
    pub color_out_dim: Option<usize>,
    /// Width of the matching stages' tokens.
    pub hidden_dim: Option<usize>,
    /// Width of the features that the coarse stage compares.
    pub coarse_out_dim: Option<usize>,
    /// Width of the features that the fine stage compares.
    pub fine_out_dim: Option<usize>,
    /// Transformer blocks of the coarse stage.
    pub coarse_blocks: Option<usize>,
    /// Transformer blocks of the fine stage.
    pub fine_blocks: Option<usize>,
    /// Output channels of the positional encoding's three shared layers.
    pub pe_channels: Option<[usize; 3]>,
    /// Input channels of the positional encoding: 6 with local reference frames, else 3.
    pub pe_inputs: Option<usize>,
}

const VIT: &str = "feature_extraction.rgb_net.vit.";

impl OfficialSizes {
    pub(super) fn of(tensors: &BTreeMap<String, TensorData>) -> Self {
        let axis = |name: &str, axis: usize| tensors.get(name).and_then(|t| t.shape().get(axis).copied());
        let vit = |name: &str, k: usize| axis(&format!("{VIT}{name}"), k);
        // One more than the largest index after the prefix.
        let count = |prefix: &str| {
            let index = |name: &String| name.strip_prefix(prefix)?.split('.').next()?.parse::<usize>().ok();
            tensors.keys().filter_map(index).max().map(|last| last + 1)
        };
        let shared = |layer: usize, k: usize| {
            axis(&format!("fine_point_matching.PE.mlp1.layer{layer}.conv.weight"), k)
        };
        Self {
            vit_embed_dim: vit("cls_token", 2),
            vit_depth: count(&format!("{VIT}blocks.")),
            vit_patch_size: vit("patch_embed.proj.weight", 2),
            vit_register_tokens: vit("cls_token", 2).map(|_| vit("reg_token", 1).unwrap_or(0)),
            vit_positions: vit("pos_embed", 1),
            color_out_dim: axis("coarse_point_matching.in_proj.weight", 1),
            hidden_dim: axis("geo_embedding.proj_d.weight", 0),
            coarse_out_dim: axis("coarse_point_matching.out_proj.weight", 0),
            fine_out_dim: axis("fine_point_matching.out_proj.weight", 0),
            coarse_blocks: count("coarse_point_matching.transformers."),
            fine_blocks: count("fine_point_matching.transformers."),
            pe_channels: shared(0, 0)
                .zip(shared(1, 0))
                .zip(shared(2, 0))
                .map(|((first, second), third)| [first, second, third]),
            pe_inputs: shared(0, 1),
        }
    }

    /// Writes the sizes into `config`; what the shapes do not tell stays.
    pub fn apply(&self, config: &mut ModelConfig) {
        fn set<T: Copy>(field: &mut T, value: Option<T>) {
            *field = value.unwrap_or(*field);
        }
        if let Some(embed_dim) = self.vit_embed_dim {
            let mut vit = match &config.color {
                ColorConfig::Vit(vit) => vit.clone(),
                ColorConfig::Conv { .. } | ColorConfig::Hybrid(_) | ColorConfig::None { .. } => {
                    VitConfig::default()
                }
            };
            if vit.embed_dim != embed_dim && embed_dim.is_multiple_of(64) {
                // Every DINOv2 transformer has heads of 64 channels.
                vit.heads = embed_dim / 64;
            }
            vit.embed_dim = embed_dim;
            set(&mut vit.depth, self.vit_depth);
            set(&mut vit.patch_size, self.vit_patch_size);
            set(&mut vit.register_tokens, self.vit_register_tokens);
            set(&mut vit.out_dim, self.color_out_dim);
            if let Some(positions) = self.vit_positions {
                vit.no_embed_class = positions.isqrt().pow(2) == positions;
                let patches = positions - usize::from(!vit.no_embed_class);
                config.image_size = patches.isqrt() * vit.patch_size;
            }
            config.color = ColorConfig::Vit(vit);
        }
        set(&mut config.geo_embedding.hidden_dim, self.hidden_dim);
        for stage in [&mut config.coarse, &mut config.fine.matching] {
            set(&mut stage.hidden_dim, self.hidden_dim);
        }
        set(&mut config.coarse.out_dim, self.coarse_out_dim);
        set(&mut config.fine.matching.out_dim, self.fine_out_dim);
        set(&mut config.coarse.blocks, self.coarse_blocks);
        set(&mut config.fine.matching.blocks, self.fine_blocks);
        set(&mut config.fine.pe_channels, self.pe_channels);
        set(&mut config.fine.use_lrf, self.pe_inputs.map(|inputs| inputs == 6));
    }

    /// Fields of `config` that disagree with the shapes: field, value of the shapes, value of the configuration.
    pub fn differences(&self, config: &ModelConfig) -> Vec<(String, String, String)> {
        let mut sized = config.clone();
        self.apply(&mut sized);
        super::super::differences(&sized, config)
    }
}

impl fmt::Display for OfficialSizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sizes = [
            ("vit_embed_dim", self.vit_embed_dim),
            ("vit_depth", self.vit_depth),
            ("vit_patch_size", self.vit_patch_size),
            ("vit_register_tokens", self.vit_register_tokens),
            ("vit_positions", self.vit_positions),
            ("color_out_dim", self.color_out_dim),
            ("hidden_dim", self.hidden_dim),
            ("coarse_out_dim", self.coarse_out_dim),
            ("fine_out_dim", self.fine_out_dim),
            ("coarse_blocks", self.coarse_blocks),
            ("fine_blocks", self.fine_blocks),
            ("pe_inputs", self.pe_inputs),
        ];
        for (name, size) in sizes {
            writeln!(f, "{name}: {}", size.map_or("absent".into(), |size| size.to_string()))?;
        }
        match self.pe_channels {
            Some(channels) => writeln!(f, "pe_channels: {channels:?}"),
            None => writeln!(f, "pe_channels: absent"),
        }
    }
}
