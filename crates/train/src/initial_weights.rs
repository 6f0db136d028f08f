//! The weights that a new run starts from.

use unopose_core::config::{ColorConfig, Config, HybridConfig, VitConfig};
use unopose_nn::{checkpoint, model::UnoPose};

use super::{TrainError, options::TrainOptions};

/// The weights that a new run starts from, unless they are random: those of `options.init`, the colour encoder's from its own
/// file where the configuration names one.
pub(super) fn load(
    config: &Config,
    options: &TrainOptions,
    random: &UnoPose,
) -> Result<Option<UnoPose>, TrainError> {
    if let Some(path) = &options.init {
        return Ok(Some(match &config.model.color {
            ColorConfig::Hybrid(HybridConfig { weights: Some(encoder), .. }) => {
                let rest = checkpoint::load_except_encoder(path, &config.model, random.clone())?;
                checkpoint::load_encoder(encoder, &config.model, rest)?
            }
            _ => checkpoint::load_weights(path, config, &options.device.clone().autodiff())?,
        }));
    }
    match &config.model.color {
        ColorConfig::Vit(VitConfig { weights: Some(path), .. }) => {
            Ok(Some(checkpoint::load_backbone(path, &config.model, random.clone())?))
        }
        ColorConfig::Hybrid(HybridConfig { weights: Some(path), .. }) => {
            Ok(Some(checkpoint::load_encoder(path, &config.model, random.clone())?))
        }
        ColorConfig::Vit(VitConfig { freeze: true, .. }) => {
            tracing::warn!("the frozen vision transformer is random: model.color.weights names no backbone");
            Ok(None)
        }
        _ => Ok(None),
    }
}
