//! What the training loop trains.

use std::path::Path;

use burn::module::Module;
use unopose_nn::checkpoint::TensorFile;
use unopose_pairs::data::SampleSource;

use super::{TrainError, journal::ValidationRecord, replicas::BatchGradients};

/// What a task is trained on.
pub type SampleOf<T> = <<T as Task>::Sampler as SampleSource>::Sample;

/// A network, its loss on a batch of samples, and how well it does on samples it is not trained on.
pub trait Task {
    /// What is trained.
    type Model: Module;
    /// Where its samples come from.
    type Sampler: SampleSource;

    /// Random weights, on the autodiff device.
    fn network(&self) -> Self::Model;

    /// The weights that a new run starts from, where they are not `random`.
    fn initial_weights(&self, random: &Self::Model) -> Result<Option<Self::Model>, TrainError>;

    /// The stream of training samples.
    fn training_sampler(&self) -> Result<Self::Sampler, TrainError>;

    /// Losses and gradients of a batch.
    fn gradients(&self, model: &Self::Model, samples: &[SampleOf<Self>]) -> BatchGradients;

    /// Puts a sample's arrays and what identifies it into `file`, under names that begin with its `index` in the batch.
    fn describe(&self, index: usize, sample: &SampleOf<Self>, file: &mut TensorFile);

    /// How `model` (without autodiff) does on the validation samples; `None` when interrupted.
    fn validate(&self, model: &Self::Model) -> Result<Option<ValidationRecord>, TrainError>;

    /// Pictures of what `model` (without autodiff) does, written into the run folder at its end.
    fn write_pictures(&self, model: &Self::Model, out: &Path) -> Result<(), TrainError>;
}
