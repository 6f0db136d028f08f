//! What several commands share.

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use unopose_cli::DeviceOption;
use unopose_core::config::{Config, HypothesisConfig, ModelConfig, Precision};
use unopose_dataset::formats::{DatasetSplits, camera::DEPTH_SCALES, image_io::MaskValue};
use unopose_infer::{PoseEstimator, Refinement};
use unopose_nn::device::DeviceChoice;

/// What camera files of other tools do not say.
#[derive(Args)]
pub struct CameraOptions {
    /// Millimetres per unit of the depth images, for camera files without depth_scale: 1 for millimetres, 0.1 for tenths of
    /// them, 1000 for metres
    #[arg(long, value_name = "MM", value_parser = depth_scale)]
    pub depth_scale: Option<f64>,
}

fn depth_scale(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(scale) if DEPTH_SCALES.contains(&scale) => Ok(scale),
        _ => {
            Err(format!("{text:?}, expected {} to {} millimetres", DEPTH_SCALES.start(), DEPTH_SCALES.end()))
        }
    }
}

/// Which images of a BOP dataset.
#[derive(Args)]
pub struct SplitOptions {
    /// Split of the targets [default: test, or the first that begins so]
    #[arg(long)]
    split: Option<String>,
    /// Split of the reference views, several separated by commas [default: that of the targets; of bench train_real for
    /// TUD-L and YCB-V]
    #[arg(long)]
    reference_split: Option<String>,
    /// Camera of scenes with several, as cam1 in rgb_cam1 and scene_camera_cam1.json
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
}

impl SplitOptions {
    pub fn of(&self, dataset: &Path) -> DatasetSplits {
        DatasetSplits {
            dataset: dataset.to_owned(),
            split: self.split.clone(),
            reference_split: self.reference_split.clone(),
            sensor: self.sensor.clone(),
        }
    }
}

/// How mask files are read.
#[derive(Args)]
pub struct MaskOptions {
    /// Mask files are label maps: the object is the pixels with this gray value or palette index, or with the colour R,G,B
    /// [default: masks have one value apart from 0, or an alpha channel that cuts the object out]
    #[arg(long, value_name = "N")]
    pub mask_value: Option<MaskValue>,
}

/// The network and how it runs.
#[derive(Args)]
pub struct EstimatorOptions {
    /// Weights [default: checkpoints/geo.safetensors beside the binary or in the working directory, else the embedded
    /// ones]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// DINOv2 weights for a checkpoint that was written without its backbone: safetensors or PyTorch, in the naming of Meta,
    /// timm or Hugging Face
    #[arg(long, value_name = "FILE", requires = "checkpoint")]
    backbone: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceOption,
    /// Number type of the network's products: f32, or bf16 (for GPUs)
    #[arg(long, default_value_t)]
    precision: Precision,
    #[command(flatten)]
    hypotheses: HypothesisOptions,
    /// Refinement after the network: none, icp or gicp (local, at most 30 mm and 15 degrees)
    #[arg(long, default_value = "none")]
    refine: Refinement,
    /// Seed of point sampling and pose hypotheses
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Confidence below which an estimate is reported as not confident [default: that of the checkpoint's calibration]
    #[arg(long, value_name = "P", value_parser = probability)]
    min_confidence: Option<f64>,
}

/// Changes of what needs no training.
#[derive(Args)]
pub struct HypothesisOptions {
    /// Change how pose hypotheses are made and judged, for example `--set model.hypotheses.starts=1`. Repeatable
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
}

impl HypothesisOptions {
    /// The changed part of `config`.
    pub fn apply(&self, config: &ModelConfig) -> anyhow::Result<HypothesisConfig> {
        if let Some(other) = self.overrides.iter().find(|set| !set.trim().starts_with("model.hypotheses.")) {
            bail!(
                "--set {other}: expected model.hypotheses.KEY=VALUE; everything else is fixed by the training"
            );
        }
        let config = Config { model: config.clone(), ..Config::default() };
        let changed = Config::from_toml(&config.to_toml()?, Path::new("--set"), &self.overrides)?;
        Ok(changed.model.hypotheses)
    }
}

fn probability(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(p) if (0.0..=1.0).contains(&p) => Ok(p),
        _ => Err(format!("{text:?}, expected a number from 0 to 1")),
    }
}

impl EstimatorOptions {
    /// For other networks than the estimator's.
    pub fn device(&self) -> DeviceChoice {
        self.device.choice()
    }

    pub fn estimator(&self) -> anyhow::Result<PoseEstimator> {
        let estimator = match (&self.checkpoint, &self.backbone) {
            (Some(path), Some(backbone)) => PoseEstimator::load_with_backbone(path, backbone, self.device())?,
            (Some(path), None) => PoseEstimator::load(path, self.device())?,
            (None, _) => PoseEstimator::load_default(self.device())?,
        };
        let hypotheses = self.hypotheses.apply(estimator.config())?;
        Ok(estimator
            .with_hypotheses(hypotheses)
            .with_precision(self.precision)?
            .with_seed(self.seed)
            .with_refinement(self.refine)
            .with_min_confidence(self.min_confidence))
    }
}
