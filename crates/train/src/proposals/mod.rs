//! Training of the network that proposes masks of unknown objects (`docs/network.md`, section 13).

mod picture;
mod validation;

use std::path::Path;

use burn::{module::Module, optim::GradientsParams, tensor::TensorData};
use unopose_core::config::{Config, ConfigError, Precision};
use unopose_nn::{
    checkpoint::{self, TensorFile},
    loss::{SceneBatch, proposal_losses},
    model::ProposalNetwork,
};
use unopose_pairs::data::{INPUT_CHANNELS, SceneSample, SceneSampler};

use super::{
    TrainError,
    datasets::Datasets,
    journal::ValidationRecord,
    options::{TrainOptions, TrainOutcome},
    replicas::{BatchGradients, join_losses, on_host, share_size, side_by_side},
    run::run,
    task::Task,
};
use validation::SceneValidation;

/// Trains the proposal network of `config` in `options.out`, or resumes the run there. Its images show every object that they
/// annotate, so generated ones must have no distractors.
pub fn train_proposals(config: &Config, options: &TrainOptions) -> Result<TrainOutcome, TrainError> {
    let wrong = |field: &str, value: String, expected: &str| {
        let (field, expected) = (field.to_owned(), expected.to_owned());
        Err(TrainError::Config(ConfigError::Range { field, value, expected }))
    };
    if config.train.precision != Precision::F32 {
        return wrong("train.precision", config.train.precision.to_string(), "f32 for a proposal network");
    }
    let generated = config.data.train.is_none() || config.data.validation.is_none();
    if generated && config.synth.distractors != [0, 0] {
        let value = format!("{:?}", config.synth.distractors);
        return wrong("synth.distractors", value, "[0, 0]: objects without a mask would count as background");
    }
    run(config, options, |datasets| ProposalTask::new(config, options, datasets))
}

struct ProposalTask<'a> {
    config: &'a Config,
    options: &'a TrainOptions,
    datasets: Datasets,
    validation: SceneValidation,
}

impl<'a> ProposalTask<'a> {
    fn new(config: &'a Config, options: &'a TrainOptions, datasets: Datasets) -> Result<Self, TrainError> {
        let validation = SceneValidation::new(config, datasets.validation_images())?;
        Ok(Self { config, options, datasets, validation })
    }
}

impl Task for ProposalTask<'_> {
    type Model = ProposalNetwork;
    type Sampler = SceneSampler;

    fn network(&self) -> ProposalNetwork {
        let device = self.options.device.clone().autodiff();
        ProposalNetwork::new(&self.config.proposals, self.config.seed, &device)
    }

    fn initial_weights(&self, random: &ProposalNetwork) -> Result<Option<ProposalNetwork>, TrainError> {
        let Some(path) = &self.options.init else { return Ok(None) };
        Ok(Some(checkpoint::load_into(path, random.clone(), &self.config.model)?.0))
    }

    fn training_sampler(&self) -> Result<SceneSampler, TrainError> {
        Ok(SceneSampler::new(self.datasets.training_images(), &self.config.proposals, self.config.seed))
    }

    /// Each thread takes some of the images through a copy of the network.
    fn gradients(&self, network: &ProposalNetwork, samples: &[SceneSample]) -> BatchGradients {
        let device = self.options.device.clone().autodiff();
        let size = share_size(samples.len(), &self.options.device);
        let parts = samples.chunks(size).map(|part| (network.clone().fork(&device), part)).collect();
        let passed = side_by_side(parts, |(network, part): (ProposalNetwork, &[SceneSample])| {
            let batch = SceneBatch::new(part.iter().map(|s| (&s.input, &s.target)), &device);
            let output = network.forward(batch.input.clone());
            let mut losses = proposal_losses(&self.config.proposals, &output, &batch);
            losses.total = losses.total * (part.len() as f64 / samples.len() as f64);
            let values = on_host(&losses);
            let gradients = (losses.total / self.config.train.accumulation as f64).backward();
            (values, GradientsParams::from_grads(gradients, &network))
        });
        let (mut losses, mut gradients) = (Vec::new(), Vec::new());
        for (values, own) in passed {
            join_losses(&mut losses, values);
            gradients.push(own);
        }
        BatchGradients { losses, gradients }
    }

    fn describe(&self, index: usize, sample: &SceneSample, file: &mut TensorFile) {
        let (input, target) = (&sample.input, &sample.target);
        let size = [input.height, input.width];
        let instances: Vec<f32> = target.instances.iter().map(|&i| i as f32).collect();
        let data = TensorData::new(input.values.clone(), [INPUT_CHANNELS, size[0], size[1]]);
        file.tensors.insert(format!("{index}.input"), data);
        file.tensors.insert(format!("{index}.instances"), TensorData::new(instances, size));
        file.metadata.insert(format!("{index}.image"), sample.image.to_string());
    }

    fn validate(&self, network: &ProposalNetwork) -> Result<Option<ValidationRecord>, TrainError> {
        self.validation.run(network, self.config, self.options)
    }

    fn write_pictures(&self, network: &ProposalNetwork, out: &Path) -> Result<(), TrainError> {
        picture::write(&out.join("proposals.png"), network, &self.validation)
    }
}
