//! A network against stored tensors of another implementation.
//!
//! [`verify`] runs the network on the inputs inside a safetensors file and compares every other tensor of the file, the
//! intermediate ones included, by the names that the project's reference files use. A file with `uniform` is an
//! evaluation (all stages down to the pose), one with `loss_total` a training step (losses, gradients, statistics).
//! Each stage is fed with what our own network computed before it, so the bounds are those of the whole chain.

mod clouds;
mod computed;
mod error;
mod evaluation;
mod hypotheses;
mod inputs;
mod report;
mod tensors;
mod tolerance;
mod training;

pub use error::VerifyError;
pub use inputs::{fit_config, guess_config};
pub use report::Report;
pub use tensors::ReferenceTensors;
pub use tolerance::Tolerances;

use std::collections::BTreeMap;

use burn::tensor::Device;
use unopose_core::config::{LossConfig, ModelConfig};
use unopose_nn::model::UnoPose;

use report::{Row, Verdict};

/// What a file of reference tensors checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Poses from stored random numbers.
    Evaluation,
    /// One step from stored initial poses.
    Training,
}

/// A network under test.
pub struct Subject<'a> {
    /// For a training file on a device with autodiff.
    pub model: &'a UnoPose,
    /// As [`fit_config`] gives it.
    pub config: &'a ModelConfig,
    /// Weights and distances of the training losses.
    pub loss: &'a LossConfig,
    /// Batches that each BatchNorm has seen, by buffer name; may be empty.
    pub batches_tracked: &'a BTreeMap<String, i64>,
}

impl Kind {
    /// By the tensors that only one kind has.
    pub fn of(tensors: &ReferenceTensors) -> Result<Self, VerifyError> {
        if tensors.contains("loss_total") {
            Ok(Self::Training)
        } else if tensors.contains("uniform") {
            Ok(Self::Evaluation)
        } else {
            let message = "is missing and loss_total too: neither an evaluation nor a training step";
            Err(tensors.error("uniform", message.into()))
        }
    }
}

/// Runs the network on the stored inputs and compares every stored tensor.
pub fn verify(
    subject: &Subject<'_>,
    tensors: &ReferenceTensors,
    tolerances: &Tolerances,
    device: &Device,
) -> Result<Report, VerifyError> {
    let kind = Kind::of(tensors)?;
    let Subject { model, config, loss, batches_tracked } = *subject;
    let pairs = inputs::pairs(tensors, config)?;
    let computed = match kind {
        Kind::Evaluation => evaluation::compute(model, config, tensors, &pairs, device)?,
        Kind::Training => training::compute(model, (config, loss), batches_tracked, tensors, &pairs, device)?,
    };
    let is_input = |name: &str| {
        inputs::INPUTS.contains(&name) || (kind == Kind::Training && ["init_R", "init_t"].contains(&name))
    };
    let rows = tensors.tensors.iter().map(|(name, stored)| match computed.0.get(name) {
        _ if is_input(name) => Row::without_numbers(name, stored, Verdict::Input),
        None => Row::without_numbers(name, stored, Verdict::NotComputed),
        Some(values) => Row::compare(name, stored, values, tolerances.of(name, stored.integer)),
    });
    Ok(Report { rows: rows.collect() })
}
