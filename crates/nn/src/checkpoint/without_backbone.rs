//! Checkpoints without their frozen backbone: small files, completed by the backbone as its publisher distributes it.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use unopose_core::config::Config;

use super::{
    CheckpointError, Meta, TensorFile, config_of, fill, load_backbone, meta_of, metadata_error,
    metadata_value, tensors_of,
};
use crate::model::{UnoPose, VisionTransformer};

/// Metadata of a checkpoint without backbone: what the backbone makes of [`test_image`].
pub(super) const KEY: &str = "backbone_features";
/// Start of the names of the backbone's tensors.
const BACKBONE: &str = "feature_extraction.rgb_net.vit.";
/// Channels of the class token that are kept.
const CHANNELS: usize = 64;
/// Largest difference between the features of the same backbone, in shares of the largest: files in half precision and other
/// devices give slightly other ones.
const TOLERANCE: f32 = 0.03;

/// Writes the checkpoint `input`, whose network has a vision transformer, without it to `output`.
pub fn strip_backbone(input: &Path, output: &Path, device: &Device) -> Result<(), CheckpointError> {
    let (model, config, _) = super::load(input, device)?;
    let Some(backbone) = &model.feature_extraction.rgb_net.vit else {
        return Err(CheckpointError::NoTransformer { path: input.to_owned() });
    };
    let features = serde_json::to_string(&test_features(backbone, config.model.image_size, device));
    let mut file = TensorFile::read(input)?;
    file.tensors.retain(|name, _| !name.starts_with(BACKBONE));
    file.metadata.insert(KEY.into(), features.unwrap_or_default());
    file.write(output)
}

/// Reads a checkpoint without backbone and completes it by `backbone`, a file of any publisher. A backbone that gives other
/// features than the one that the network was trained with is refused.
pub fn load_with_backbone(
    path: &Path,
    backbone: &Path,
    device: &Device,
) -> Result<(UnoPose, Config, Meta), CheckpointError> {
    let mut file = TensorFile::read(path)?;
    let absent = |key, expected| metadata_error(path, key, "absent", expected);
    let config = config_of(&file, path)?.ok_or_else(|| absent("config", "a configuration"))?;
    let meta = meta_of(&file, path)?;
    let stored: Option<Vec<f32>> = metadata_value(&file.metadata, KEY, path, "a list of features")?;
    let stored = stored.ok_or_else(|| absent(KEY, "a checkpoint that was written without its backbone"))?;
    let model = load_backbone(backbone, &config.model, UnoPose::new(&config.model, config.seed, device))?;
    let found = model
        .feature_extraction
        .rgb_net
        .vit
        .as_ref()
        .map(|network| test_features(network, config.model.image_size, device))
        .unwrap_or_default();
    let largest = stored.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    let near = |(a, b): (&f32, &f32)| (a - b).abs() <= TOLERANCE * largest;
    if found.len() != stored.len() || !stored.iter().zip(&found).all(near) {
        return Err(CheckpointError::OtherBackbone { path: path.to_owned(), backbone: backbone.to_owned() });
    }
    let own = tensors_of(&model, path)?;
    file.tensors.extend(own.into_iter().filter(|(name, _)| name.starts_with(BACKBONE)));
    Ok((fill(model, file, path, Some(&config.model))?, config, meta))
}

/// What a backbone makes of the test image: the first channels of its class token.
fn test_features(network: &VisionTransformer, image_size: usize, device: &Device) -> Vec<f32> {
    let class_token = network.forward(test_image(image_size, device)).class_token;
    let values: Vec<f32> = class_token.into_data().iter::<f32>().collect();
    values.into_iter().take(CHANNELS).collect()
}

/// Waves in three channels, `[1, 3, S, S]`.
fn test_image(side: usize, device: &Device) -> Tensor<4> {
    let value = |index: usize| {
        let (channel, row, column) = (index / (side * side), index / side % side, index % side);
        let phase = (row * (channel + 2) + column * (3 - channel)) as f32 / side as f32;
        (std::f32::consts::TAU * phase).sin()
    };
    let values: Vec<f32> = (0..3 * side * side).map(value).collect();
    Tensor::from_data(TensorData::new(values, [1, 3, side, side]), device)
}
