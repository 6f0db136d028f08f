//! Why a training run stopped or could not begin.

use std::path::PathBuf;

use unopose_core::{config::ConfigError, files::FileError};
use unopose_dataset::{formats::FormatError, mesh::MeshError};
use unopose_eval::report::ReportError;
use unopose_infer::InferError;
use unopose_nn::{checkpoint::CheckpointError, device::DeviceError};
use unopose_pairs::data::DataError;
use unopose_synth::SynthError;

#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Write(#[from] FileError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    Data(#[from] DataError),
    #[error(transparent)]
    Synth(#[from] SynthError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Infer(#[from] InferError),
    #[error("train.precision: {0}")]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("{}: {message}", path.display())]
    State { path: PathBuf, message: String },
    #[error(
        "{} was trained with {field} = {theirs}, now it is {ours}: \
         choose another --out, or --fresh to begin again",
        path.display()
    )]
    OtherModel { path: PathBuf, field: String, theirs: String, ours: String },
    #[error("the loss is {value} at step {step} ({term}); the batch is saved in {}", batch.display())]
    NonFiniteLoss { step: u64, value: f64, term: String, batch: PathBuf },
    #[error("{0}")]
    Unusable(String),
}
