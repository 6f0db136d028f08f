//! Training of the pose network.

use std::path::Path;

use unopose_core::config::Config;
use unopose_nn::{
    checkpoint::{self, TensorFile},
    model::{FeatureExtraction, UnoPose},
};
use unopose_pairs::data::{PairSampler, TrainSample};

use super::{
    TrainError,
    bad_batch::describe_pair,
    datasets::Datasets,
    figures, initial_weights,
    journal::ValidationRecord,
    options::TrainOptions,
    replicas::{BatchGradients, forward_backward_keeping},
    task::Task,
    validation::Validation,
};

/// The pose network with its losses, and the poses it gives.
pub struct PoseTask<'a> {
    config: &'a Config,
    options: &'a TrainOptions,
    datasets: Datasets,
    validation: Validation,
    /// The distilled encoder, whose structure the features keep.
    kept: Option<FeatureExtraction>,
}

impl<'a> PoseTask<'a> {
    /// Opens the validation pairs, and the distilled encoder where its structure is kept.
    pub fn new(
        config: &'a Config,
        options: &'a TrainOptions,
        datasets: Datasets,
    ) -> Result<Self, TrainError> {
        let kept = kept_encoder(config, options)?;
        let validation = datasets.validation(config)?;
        Ok(Self { config, options, datasets, validation, kept })
    }
}

impl Task for PoseTask<'_> {
    type Model = UnoPose;
    type Sampler = PairSampler;

    fn network(&self) -> UnoPose {
        UnoPose::new(&self.config.model, self.config.seed, &self.options.device.clone().autodiff())
    }

    fn initial_weights(&self, random: &UnoPose) -> Result<Option<UnoPose>, TrainError> {
        initial_weights::load(self.config, self.options, random)
    }

    fn training_sampler(&self) -> Result<PairSampler, TrainError> {
        self.datasets.training_sampler(self.config)
    }

    fn gradients(&self, model: &UnoPose, samples: &[TrainSample]) -> BatchGradients {
        let device = self.options.device.clone().autodiff();
        forward_backward_keeping(model, self.config, samples, &device, self.kept.as_ref())
    }

    fn describe(&self, index: usize, sample: &TrainSample, file: &mut TensorFile) {
        describe_pair(index, sample, file);
    }

    fn validate(&self, model: &UnoPose) -> Result<Option<ValidationRecord>, TrainError> {
        let TrainOptions { device, observer, interrupt, .. } = self.options;
        self.validation.run(model, self.config, device, &**observer, interrupt)
    }

    fn write_pictures(&self, model: &UnoPose, out: &Path) -> Result<(), TrainError> {
        let path = out.join("poses.png");
        figures::write_pose_sheet(&path, model, self.config, &self.validation, &self.options.device)
    }
}

/// The encoder of `loss.kept_encoder`.
fn kept_encoder(config: &Config, options: &TrainOptions) -> Result<Option<FeatureExtraction>, TrainError> {
    let Some(path) = &config.loss.kept_encoder else { return Ok(None) };
    let random = UnoPose::new(&config.model, config.seed, &options.device);
    let model = checkpoint::load_encoder(path, &config.model, random)?;
    Ok(Some(model.feature_extraction))
}
