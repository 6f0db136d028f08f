//! What a run tells its caller while it works.

use std::time::Duration;

/// A part of a run with a known number of items.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Phase {
    /// The objects of the generated training set.
    TrainingModels,
    /// The images of the generated training set.
    TrainingImages,
    /// The objects of the generated validation set.
    ValidationModels,
    /// The images of the generated validation set.
    ValidationImages,
    /// The optimizer steps of the run.
    Training,
    /// The pairs of one validation.
    Validation,
}

impl Phase {
    /// A few words for a progress display.
    pub fn label(self) -> &'static str {
        match self {
            Self::TrainingModels | Self::TrainingImages => "training set",
            Self::ValidationModels | Self::ValidationImages => "validation set",
            Self::Training => "training",
            Self::Validation => "validating",
        }
    }
}

/// The items of a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PhaseExtent {
    /// Items that were done before this call.
    pub first: u64,
    /// All items, those before this call included.
    pub total: u64,
    /// The phase ends after this time, whatever its count.
    pub time_limit: Option<Duration>,
}

impl PhaseExtent {
    /// Items `first..total`, without a limit on the time.
    pub fn new(first: u64, total: u64) -> Self {
        Self { first, total, time_limit: None }
    }

    /// The phase ends after this time, if it is given.
    pub fn with_time_limit(self, time_limit: Option<Duration>) -> Self {
        Self { time_limit, ..self }
    }
}

/// Follows a run. Every method does nothing unless it is implemented; `()` follows nothing.
///
/// Phases nest: a validation begins and ends during training. While data are generated, the methods are called from
/// several threads, one call at a time per data set, and counts may arrive out of order.
pub trait TrainObserver: Send + Sync {
    /// A phase begins.
    fn begin(&self, _phase: Phase, _extent: PhaseExtent) {}

    /// `done` items of the phase are finished, those before this call included. `note` is a short remark on the last
    /// one (such as its loss), or empty.
    fn advance(&self, _phase: Phase, _done: u64, _note: &str) {}

    /// A phase has ended. Not called when an error ends it.
    fn end(&self, _phase: Phase) {}

    /// A line that should stay on the screen, such as the result of a validation.
    fn line(&self, _text: &str) {}
}

impl TrainObserver for () {}
