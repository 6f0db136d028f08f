//! Which pairs are drawn for training and how they are augmented.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Pairs of views. Defaults are the release's (`docs/network.md`, section 8).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DataConfig {
    /// Folder of MegaPose-style shards to train on. Unset: synthetic data, generated when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub train: Option<PathBuf>,
    /// Folder of shards to validate on. Unset: synthetic data, generated when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validation: Option<PathBuf>,
    /// Smallest visible share of a query instance's silhouette.
    pub min_visible_fraction: f32,
    /// Fewest visible pixels of an instance, query or reference. The default suits images of 640 x 480, a quarter of it
    /// images of 320 x 240. Index files beside the shards may list fewer instances than this admits.
    pub min_visible_pixels: u32,
    /// Smallest visible share of a reference instance's silhouette. Index files of datasets list instances from 0.8.
    pub min_reference_visible_fraction: f32,
    /// Largest rotation between the two views up to the object's symmetries, degrees. 180: any.
    pub max_rotation_deg: f64,
    /// Smallest share of query points with a reference point within `overlap_distance`. 0: any.
    pub min_overlap: f64,
    /// Distance that counts as overlap for `min_overlap`, object radii.
    pub overlap_distance: f32,
    /// Memory for decoded images, MiB. 0: images are decoded for every draw.
    pub cache_mib: usize,
    /// Random changes of training pairs.
    pub augmentation: AugmentationConfig,
    /// Noise that turns the true pose into the initial pose of the fine stage in training.
    pub pose_noise: PoseNoiseConfig,
}

/// Random changes of training pairs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AugmentationConfig {
    /// Probability of the colour changes, per crop.
    pub color_probability: f64,
    /// Probability that the query's mask is dilated.
    pub dilation_probability: f64,
    /// Number of dilations of the query's mask with a 3 x 3 cross. 0: none.
    pub dilation_iterations: usize,
    /// Rotate the reference cloud by a random rotation.
    pub rotate_reference: bool,
    /// Largest shift of the query cloud per axis, metres. The label follows the shift.
    pub query_shift: f64,
    /// Standard deviation of the noise of every query point per axis, metres.
    pub query_noise: f64,
}

/// Noise that turns the true pose into the initial pose of the fine stage in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PoseNoiseConfig {
    /// Standard deviations of the rotation per axis, degrees. One of them is drawn for every 8 samples.
    pub rotation_std_deg: Vec<f64>,
    /// Rotations are clipped at this angle per axis, degrees.
    pub max_rotation_deg: f64,
    /// Standard deviation of the translation per axis, object radii.
    pub translation_std: f64,
    /// Translations are clipped at this distance per axis, object radii.
    pub max_translation: f64,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            train: None,
            validation: None,
            min_visible_fraction: 0.1,
            min_visible_pixels: 512,
            min_reference_visible_fraction: 0.8,
            max_rotation_deg: 180.0,
            min_overlap: 0.0,
            overlap_distance: 0.15,
            cache_mib: 1024,
            augmentation: AugmentationConfig::default(),
            pose_noise: PoseNoiseConfig::default(),
        }
    }
}

impl Default for AugmentationConfig {
    fn default() -> Self {
        Self {
            color_probability: 0.8,
            dilation_probability: 0.5,
            dilation_iterations: 4,
            rotate_reference: true,
            query_shift: 0.01,
            query_noise: 0.001,
        }
    }
}

impl Default for PoseNoiseConfig {
    fn default() -> Self {
        Self {
            rotation_std_deg: vec![15.0, 10.0, 5.0, 1.25, 1.0],
            max_rotation_deg: 45.0,
            translation_std: 0.2,
            max_translation: 0.8,
        }
    }
}
