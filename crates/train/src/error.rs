//! Why a training run failed or could not start.

use std::path::PathBuf;

use unopose_core::{config::ConfigError, files::FileError, folder_lock::LockError};
use unopose_dataset::{formats::FormatError, mesh::MeshError};
use unopose_eval::report::ReportError;
use unopose_infer::InferError;
use unopose_nn::{checkpoint::CheckpointError, device::DeviceError};
use unopose_pairs::data::DataError;
use unopose_synth::SynthError;

/// Why a training run failed or could not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A file or folder of the run cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system reports.
        source: std::io::Error,
    },
    /// A file cannot be written atomically.
    #[error(transparent)]
    Write(#[from] FileError),
    /// Another process trains in the run folder.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A data set or its model list is malformed.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The configuration cannot be written to the run folder.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A checkpoint cannot be read, does not fit the network or cannot be written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A pair cannot be prepared.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The synthetic data cannot be generated.
    #[error(transparent)]
    Synth(#[from] SynthError),
    /// A mesh of the validation set cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The pose of a validation pair cannot be estimated.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The device cannot compute in `train.precision`.
    #[error("train.precision: {0}")]
    Device(#[from] DeviceError),
    /// The curves or the pose sheet cannot be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The saved state of a run is damaged or cannot be encoded.
    #[error("{}: {message}", path.display())]
    State {
        /// `last.safetensors` or a file of the state folder.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// The run folder holds a run of another network.
    #[error(
        "{} was trained with {field} = {theirs}, now it is {ours}: \
         choose another --out, or --fresh to begin again",
        path.display()
    )]
    OtherModel {
        /// The checkpoint in the folder.
        path: PathBuf,
        /// The first configuration value that differs, such as `model.coarse.temperature`.
        field: String,
        /// Its value in the checkpoint.
        theirs: String,
        /// Its value in the configuration of this call.
        ours: String,
    },
    /// A loss is infinite or NaN.
    #[error("the loss is {value} at step {step} ({term}); the batch is saved in {}", batch.display())]
    NonFiniteLoss {
        /// The step that would have been taken, counted from 1.
        step: u64,
        /// Infinity or NaN.
        value: f64,
        /// Name of the first term that is not finite, `total` for their sum.
        term: String,
        /// Where the batch was saved.
        batch: PathBuf,
    },
    /// The stream of training pairs is of no use.
    #[error("{0}")]
    Unusable(String),
}
