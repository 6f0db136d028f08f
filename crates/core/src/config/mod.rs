//! The one configuration tree (TOML).
//!
//! [`Config::load`] reads a file that holds only what differs from the defaults, applies `--set a.b=c` overrides and
//! checks every range; [`Config::to_toml`] writes the complete, resolved tree. Unknown keys are errors that name the
//! file, the line and the nearest valid key.

mod color;
mod data;
mod error;
mod load;
mod loss;
mod model;
mod official;
mod overrides;
mod precision;
mod quirks;
mod synth;
mod train;
mod validate;

pub use color::{ColorConfig, PositionResampling, VitConfig};
pub use data::{AugmentationConfig, DataConfig, PoseNoiseConfig};
pub use error::ConfigError;
pub use load::EMBEDDED_NAMES;
pub use loss::LossConfig;
pub use model::{
    EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, HypothesisConfig, HypothesisScore, MatchingConfig,
    ModelConfig, OverlapMode,
};
pub use precision::Precision;
pub use quirks::Quirks;
pub use synth::{MeshLayout, MeshSize, SensorConfig, SynthCameraConfig, SynthConfig};
pub use train::TrainConfig;

use serde::{Deserialize, Serialize};

/// Everything a run depends on, apart from the data's content and the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Name of the run: results go to `runs/<name>`.
    pub name: String,
    /// Seed of every random stream: data, initial weights, sampling.
    pub seed: u64,
    /// The training set when `data.train` names none; the validation set is a smaller one of other objects.
    pub synth: SynthConfig,
    pub data: DataConfig,
    pub model: ModelConfig,
    pub loss: LossConfig,
    pub train: TrainConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            name: "unopose".into(),
            seed: 0,
            synth: SynthConfig::default(),
            data: DataConfig::default(),
            model: ModelConfig::default(),
            loss: LossConfig::default(),
            train: TrainConfig::default(),
        }
    }
}
