//! Training of the pose network.

use std::path::Path;

use unopose_core::config::Config;
use unopose_nn::model::UnoPose;
use unopose_pairs::data::{PairSampler, TrainSample};

use super::{
    TrainError,
    datasets::Datasets,
    figures, initial_weights,
    journal::ValidationRecord,
    options::TrainOptions,
    replicas::{BatchGradients, forward_backward},
    task::Task,
    validation::Validation,
};

/// The pose network with its losses, and the poses it gives.
pub struct PoseTask<'a> {
    config: &'a Config,
    options: &'a TrainOptions,
    datasets: Datasets,
    validation: Validation,
}

impl<'a> PoseTask<'a> {
    /// Opens the validation pairs.
    pub fn new(
        config: &'a Config,
        options: &'a TrainOptions,
        datasets: Datasets,
    ) -> Result<Self, TrainError> {
        let validation = datasets.validation(config)?;
        Ok(Self { config, options, datasets, validation })
    }
}

impl Task for PoseTask<'_> {
    type Model = UnoPose;

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
        forward_backward(model, self.config, samples, &self.options.device.clone().autodiff())
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
