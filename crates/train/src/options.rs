//! What a call to train gets besides the configuration, and what it gives back.

use std::{path::PathBuf, sync::Arc, time::Duration};

use burn::tensor::Device;

use super::{interrupt::Interrupt, journal::ValidationRecord, observer::TrainObserver};

/// What a call adds to the configuration.
pub struct TrainOptions {
    /// Run folder.
    pub out: PathBuf,
    /// Where synthetic data are kept: `<data_root>/<name>`.
    pub data_root: PathBuf,
    /// Start from these weights when the folder has no checkpoint.
    pub init: Option<PathBuf>,
    /// Delete an earlier run in the folder instead of resuming it.
    pub fresh: bool,
    /// End after this time, data generation, validation and report included.
    pub time_limit: Option<Duration>,
    /// Without autodiff.
    pub device: Device,
    /// Save and leave when the run has taken this many steps, as after Ctrl-C.
    pub stop_at: Option<u64>,
    /// Set from outside (Ctrl-C) to save and leave.
    pub interrupt: Arc<Interrupt>,
    /// Told how far the run is; `Arc::new(())` for nobody.
    pub observer: Arc<dyn TrainObserver>,
}

/// Why a call stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// An earlier call took the last step.
    AlreadyFinished,
    Finished,
    TimeUp,
    Interrupted,
}

/// What a call did.
#[derive(Clone, Debug)]
pub struct TrainOutcome {
    /// Why the call stopped.
    pub stop_reason: StopReason,
    /// Steps of the run so far.
    pub step: u64,
    /// All validations of the run, in order.
    pub validations: Vec<ValidationRecord>,
}
