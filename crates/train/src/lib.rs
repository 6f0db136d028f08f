//! Training: the loop, the optimizer's state, exact resume, validation, and what a run leaves behind.
//!
//! [`train`] does everything `unotrain` does and tells a [`TrainObserver`] how far it is. A run folder holds
//! `best.safetensors` (weights of the best validation), `last.safetensors` and `state-<step>` (everything a resume
//! needs), `metrics.jsonl`, `curves.svg`, `poses.png` and the resolved `config.toml`. A resumed run continues bit for
//! bit: weights, moments, averages, schedule and the position in the stream of pairs are saved, and random numbers
//! belong to pairs, not to the process. After a validation the best weights are written first, with their score in
//! them, then the journal's line, then the state: whatever is lost with a process that dies is done again. One process
//! at a time works in a run folder.

mod bad_batch;
mod best;
mod datasets;
mod distil;
mod ema;
mod error;
mod figures;
mod folder;
mod gradients;
mod initial_weights;
mod journal;
mod observer;
mod optimization;
mod options;
mod pose_task;
mod proposals;
mod replicas;
mod run;
mod schedule;
mod state;
mod task;
mod validation;

pub use distil::distil;
pub use error::TrainError;
pub use journal::{Event, Journal, ProposalRecall, StepRecord, ValidationRecord};
pub use observer::{Phase, PhaseExtent, TrainObserver};
pub use optimization::Optimization;
pub use options::{StopReason, TrainOptions, TrainOutcome};
pub use proposals::train_proposals;
pub use replicas::{BatchGradients, forward_backward};
pub use run::train;
