//! The one configuration tree (TOML).

mod loss;
mod model;

pub use loss::LossConfig;
pub use model::{
    ColorConfig, EmbeddingEvaluation, FineConfig, GeoEmbeddingConfig, HypothesisConfig, MatchingConfig,
    ModelConfig, OverlapMode, Quirks, VitConfig,
};
