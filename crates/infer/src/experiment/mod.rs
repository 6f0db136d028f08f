//! What is changed on purpose to measure what it is worth: references without their colours, networks without training.

mod reference_color;

pub use reference_color::ReferenceColor;

use unopose_nn::model::UnoPose;

use super::PoseEstimator;

/// The same network with weights drawn anew from a seed, without a calibration: what training has to beat.
pub fn untrained(estimator: PoseEstimator, seed: u64) -> PoseEstimator {
    let model = UnoPose::new(&estimator.config, seed, &estimator.device);
    let source = format!("untrained network of {}", estimator.source);
    PoseEstimator { model, source, calibration: None, network: Default::default(), ..estimator }
}
