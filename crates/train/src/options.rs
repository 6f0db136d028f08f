//! What a call of `train` takes besides the configuration, and what it returns.

use std::{path::PathBuf, sync::Arc, time::Duration};

use burn::tensor::Device;
use unopose_core::interrupt::Interrupt;

use super::{journal::ValidationRecord, observer::TrainObserver};

/// What a call adds to the configuration.
pub struct TrainOptions {
    /// Run folder.
    pub out: PathBuf,
    /// Where synthetic data are kept: `<data_root>/<name>`.
    pub data_root: PathBuf,
    /// Start from the weights in this checkpoint or official state when the folder has no checkpoint. Where `model.color.weights`
    /// of a hybrid encoder is set, the encoder comes from there.
    pub init: Option<PathBuf>,
    /// Delete an earlier run in the folder instead of resuming it, once the new one has all it needs to begin.
    pub fresh: bool,
    /// Resume from the weights alone, without the optimizer's moments.
    pub reset_optimizer: bool,
    /// Stop after this time, data generation, validation and report included.
    pub time_limit: Option<Duration>,
    /// Where to compute; without autodiff.
    pub device: Device,
    /// Save and stop when the run has taken this many steps, as after an interrupt.
    pub stop_at: Option<u64>,
    /// Asked from outside (Ctrl-C, SIGTERM) to save and stop.
    pub interrupt: Arc<Interrupt>,
    /// Told how far the run is; `Arc::new(())` for nobody.
    pub observer: Arc<dyn TrainObserver>,
}

/// Why a call stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StopReason {
    /// An earlier call took the last step.
    AlreadyFinished,
    /// This call took the last step.
    Finished,
    /// The time limit is reached; the run can be resumed.
    TimeUp,
    /// Interrupted from outside or at `stop_at`; the run can be resumed.
    Interrupted,
}

/// What a call did.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrainOutcome {
    /// Why the call stopped.
    pub stop_reason: StopReason,
    /// Steps of the run so far.
    pub step: u64,
    /// All validations of the run, in order.
    pub validations: Vec<ValidationRecord>,
}
