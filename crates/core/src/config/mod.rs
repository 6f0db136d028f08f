//! The one configuration tree (TOML).
//!
//! [`Config::load`] reads a file that holds only what differs from the defaults, applies `--set a.b=c` overrides and
//! checks every range; [`Config::to_toml`] writes the complete, resolved tree and [`Config::to_commented_toml`] explains
//! every key of it. Unknown keys are errors that name the file, the line and the nearest valid key.
//!
//! The fields' doc comments are the programs' documentation of the configuration: each says meaning, unit and special
//! values. The limits of all numbers stand in `limits.rs`, how they depend on each other in
//! `validate.rs`.

mod color;
mod commented;
mod data;
mod distil;
mod error;
mod limits;
mod load;
mod loss;
mod model;
mod official;
mod overrides;
mod precision;
mod proposals;
mod quirks;
mod schema;
mod synth;
mod train;
mod validate;

pub use color::{ColorConfig, HybridConfig, PositionResampling, VitConfig};
pub use data::{AugmentationConfig, DataConfig, PoseNoiseConfig};
pub use distil::DistilConfig;
pub use error::ConfigError;
pub use limits::MAX_THREADS;
pub use load::EMBEDDED_NAMES;
pub use loss::LossConfig;
pub use model::{
    EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, HypothesisConfig, HypothesisScore, MatchingConfig,
    ModelConfig, OverlapMode,
};
pub use precision::Precision;
pub use proposals::ProposalConfig;
pub use quirks::Quirks;
pub use synth::{MeshLayout, MeshSize, SensorConfig, SynthCameraConfig, SynthConfig};
pub use train::TrainConfig;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything a run depends on, apart from the data's content and the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Name of the run. Results go to `runs/<name>`, generated data to `data/<name>`.
    pub name: String,
    /// Seed of the initial weights, the choice of pairs, their augmentation and all sampling. Generated data depend on
    /// `synth.seed` instead.
    pub seed: u64,
    /// The generated training set, used when `data.train` names none. The generated validation set is a smaller one of
    /// other objects.
    pub synth: SynthConfig,
    /// Which pairs of views are drawn from the data, and how they are augmented.
    pub data: DataConfig,
    /// The network and the preparation of its inputs.
    pub model: ModelConfig,
    /// Terms of the training loss.
    pub loss: LossConfig,
    /// Distillation of the colour encoder (`unotrain distil`).
    pub distil: DistilConfig,
    /// The network that proposes masks of unknown objects (`unotrain proposals`).
    pub proposals: ProposalConfig,
    /// Optimisation, its schedule, validation and checkpoints.
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
            distil: DistilConfig::default(),
            proposals: ProposalConfig::default(),
            train: TrainConfig::default(),
        }
    }
}
