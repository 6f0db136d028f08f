//! What the training loop trains.

use std::path::Path;

use burn::module::Module;
use unopose_pairs::data::{PairSampler, TrainSample};

use super::{TrainError, journal::ValidationRecord, replicas::BatchGradients};

/// A network, its loss on a batch of pairs, and how well it does on pairs it is not trained on.
pub trait Task {
    /// What is trained.
    type Model: Module;

    /// Random weights, on the autodiff device.
    fn network(&self) -> Self::Model;

    /// The weights that a new run starts from, where they are not `random`.
    fn initial_weights(&self, random: &Self::Model) -> Result<Option<Self::Model>, TrainError>;

    /// The stream of training pairs.
    fn training_sampler(&self) -> Result<PairSampler, TrainError>;

    /// Losses and gradients of a batch.
    fn gradients(&self, model: &Self::Model, samples: &[TrainSample]) -> BatchGradients;

    /// How `model` (without autodiff) does on the validation pairs; `None` when interrupted.
    fn validate(&self, model: &Self::Model) -> Result<Option<ValidationRecord>, TrainError>;

    /// Pictures of what `model` (without autodiff) does, written into the run folder at its end.
    fn write_pictures(&self, model: &Self::Model, out: &Path) -> Result<(), TrainError>;
}
