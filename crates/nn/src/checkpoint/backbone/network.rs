//! From a backbone on the host to a vision transformer: sizes, position embedding, parameters.

use std::{collections::BTreeMap, path::Path};

use burn::{
    module::Module,
    tensor::{Device, TensorData},
};
use unopose_core::config::{ColorConfig, ModelConfig, PositionResampling, VitConfig};

use super::{Backbone, CheckpointError, Mismatch, PUBLISHED, Resampling, TensorFile, fill};
use crate::model::{Initializer, UnoPose, VisionTransformer};

/// Channels of a head of DINOv2's transformers.
const HEAD_CHANNELS: usize = 64;

impl Backbone {
    /// Parameters of a transformer of `config` for images of `image_size` pixels: the position embedding resampled, and
    /// the class token's entry of it where `config` has it.
    fn parameters(&self, config: &VitConfig, image_size: usize) -> BTreeMap<String, TensorData> {
        let mut tensors = self.tensors.clone();
        let sizes = self.sizes();
        let width = sizes.embed_dim;
        let (Some(class), Some(positions)) = (tensors.get("cls_token"), tensors.get("pos_embed")) else {
            return tensors;
        };
        let (Ok(class), Ok(stored)) = (class.as_slice::<f32>(), positions.as_slice::<f32>()) else {
            return tensors;
        };
        let patches = sizes.side * sizes.side;
        let first = width * usize::from(sizes.class_position);
        if class.len() != width || stored.len() != first + patches * width || config.patch_size == 0 {
            return tensors;
        }
        let side = image_size / config.patch_size;
        let way = Resampling::of(config.position_resampling, self.naming, sizes.register_tokens > 0);
        let mut grid = way.resample(&stored[first..], sizes.side, side, width);
        let class_position = if sizes.class_position { stored[..width].to_vec() } else { vec![0.0; width] };
        if config.no_embed_class {
            let class = class.iter().zip(&class_position).map(|(c, p)| c + p).collect::<Vec<f32>>();
            tensors.insert("cls_token".into(), TensorData::new(class, [1, 1, width]));
        } else {
            grid.splice(0..0, class_position);
        }
        let count = grid.len() / width;
        tensors.insert("pos_embed".into(), TensorData::new(grid, [1, count, width]));
        tensors
    }

    /// Sizes that disagree with the configuration: field, value of the file, value of the configuration.
    fn differences(&self, config: &VitConfig) -> Vec<(String, String, String)> {
        let sizes = self.sizes();
        let heads = match PUBLISHED.iter().any(|&(width, ..)| width == sizes.embed_dim) {
            true => sizes.embed_dim / HEAD_CHANNELS,
            false => config.heads,
        };
        [
            ("embed_dim", sizes.embed_dim, config.embed_dim),
            ("depth", sizes.depth, config.depth),
            ("heads", heads, config.heads),
            ("patch_size", sizes.patch_size, config.patch_size),
            ("register_tokens", sizes.register_tokens, config.register_tokens),
        ]
        .into_iter()
        .filter(|(_, theirs, ours)| theirs != ours)
        .map(|(field, theirs, ours)| (format!("model.color.{field}"), theirs.to_string(), ours.to_string()))
        .collect()
    }

    /// The configuration of a transformer with these sizes and DINOv2's heads, for images of `image_size` pixels.
    fn own_config(&self, image_size: usize) -> Result<VitConfig, CheckpointError> {
        let sizes = self.sizes();
        let needed = ["cls_token", "pos_embed", "patch_embed.proj.weight"].into_iter();
        let mut missing: Vec<String> =
            needed.filter(|&name| !self.tensors.contains_key(name)).map(str::to_owned).collect();
        let has_block = |i: usize| self.tensors.keys().any(|name| name.starts_with(&format!("blocks.{i}.")));
        let first_absent = (0..sizes.depth).find(|&i| !has_block(i)).or((sizes.depth == 0).then_some(0));
        missing.extend(first_absent.map(|i| format!("blocks.{i}.attn.qkv.weight")));
        if !missing.is_empty() {
            let mismatch = Mismatch { missing, extra: self.unknown.clone(), ..Mismatch::default() };
            return Err(CheckpointError::Mismatch { path: self.path.clone(), mismatch: Box::new(mismatch) });
        }
        let shape = |name: &'static str, expected: String| {
            let shape = self.tensors.get(name).map(|t| t.shape().to_vec()).unwrap_or_default();
            let message = format!("shape is {shape:?}, expected {expected}");
            CheckpointError::Tensor { path: self.path.clone(), name: name.into(), message }
        };
        let (width, patch) = (sizes.embed_dim, sizes.patch_size);
        if width == 0 || !width.is_multiple_of(HEAD_CHANNELS) {
            let expected = format!("[1, 1, a multiple of {HEAD_CHANNELS}], the channels of a head of DINOv2");
            return Err(shape("cls_token", expected));
        }
        if patch == 0 || !image_size.is_multiple_of(patch) {
            let expected = format!("[{width}, 3, p, p] with patches that divide {image_size} pixels");
            return Err(shape("patch_embed.proj.weight", expected));
        }
        Ok(VitConfig {
            embed_dim: width,
            depth: sizes.depth,
            heads: width / HEAD_CHANNELS,
            patch_size: patch,
            register_tokens: sizes.register_tokens,
            no_embed_class: !sizes.class_position,
            position_resampling: PositionResampling::Source,
            ..VitConfig::default()
        })
    }

    /// The transformer of this backbone for images of `image_size` pixels.
    pub fn into_transformer(
        self,
        image_size: usize,
        device: &Device,
    ) -> Result<VisionTransformer, CheckpointError> {
        let config = self.own_config(image_size)?;
        // Every parameter is replaced; the seed does not matter.
        let network = VisionTransformer::new(&config, image_size, &mut Initializer::new(0, device));
        self.filled(&config, image_size, network)
    }

    /// `model` with these weights in its vision transformer. Every size that disagrees and every missing, unknown and
    /// wrongly shaped tensor is listed in the error.
    pub fn into_model(self, config: &ModelConfig, mut model: UnoPose) -> Result<UnoPose, CheckpointError> {
        let net = &mut model.feature_extraction.rgb_net;
        let (ColorConfig::Vit(vit), Some(network)) = (&config.color, net.vit.take()) else {
            return Err(CheckpointError::NoTransformer { path: self.path });
        };
        let network = self.filled(vit, config.image_size, network)?;
        net.vit = Some(if vit.freeze { network.no_grad() } else { network });
        Ok(model)
    }

    /// `network`, which was made from `config`, with these weights.
    fn filled(
        self,
        config: &VitConfig,
        image_size: usize,
        network: VisionTransformer,
    ) -> Result<VisionTransformer, CheckpointError> {
        let differences = self.differences(config);
        let file = TensorFile { tensors: self.parameters(config, image_size), metadata: BTreeMap::new() };
        let agrees = differences.is_empty() && self.unknown.is_empty();
        let mismatch = match fill(network, file, &self.path, None) {
            Ok(network) if agrees => return Ok(network),
            Ok(_) => Mismatch::default(),
            Err(CheckpointError::Mismatch { mismatch, .. }) => *mismatch,
            Err(other) => return Err(other),
        };
        let parts = |name: String| self.incomplete.get(&name).cloned().unwrap_or_else(|| vec![name]);
        let missing = mismatch.missing.into_iter().flat_map(parts).collect();
        let extra = mismatch.extra.into_iter().chain(self.unknown).collect();
        let mismatch = Mismatch { config: differences, missing, extra, ..mismatch };
        Err(CheckpointError::Mismatch { path: self.path, mismatch: Box::new(mismatch) })
    }

    /// Notices go to the log.
    fn report(&self) {
        let path = self.path.display();
        self.notices.iter().for_each(|notice| tracing::warn!("{path}: {notice}"));
        if !self.unused.is_empty() {
            tracing::info!("{path}: stored but not used: {}", self.unused.join(", "));
        }
    }
}

/// `model` with the backbone of a file in its vision transformer; notices go to the log.
pub fn load_backbone(path: &Path, config: &ModelConfig, model: UnoPose) -> Result<UnoPose, CheckpointError> {
    let backbone = Backbone::open(path)?;
    backbone.report();
    backbone.into_model(config, model)
}

/// The backbone of a file for images of `image_size` pixels; notices go to the log.
pub fn load_transformer(
    path: &Path,
    image_size: usize,
    device: &Device,
) -> Result<VisionTransformer, CheckpointError> {
    let backbone = Backbone::open(path)?;
    backbone.report();
    backbone.into_transformer(image_size, device)
}
