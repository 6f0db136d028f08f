//! Methods side by side on the targets of a dataset.
//!
//! [`ListRequest`] reads or builds the lists of a protocol; [`Suite`] runs every method on one of them and writes all that
//! is known afterwards. It estimates the targets pair by pair and keeps each result, so that a run that was stopped
//! resumes; it scores the methods with confidence intervals and paired differences, and writes the tables as Markdown, CSV,
//! JSON and a page. [`run_sequence`] does the same for phone sequences, which have camera poses instead of models.
//!
//! [`analysis`] looks at every stage of an estimate, [`verify`] compares a network with another implementation's tensors.

mod ablation;
pub mod analysis;
mod cells;
mod comparison;
mod comparison_sections;
mod detection_source;
mod error;
mod examples;
mod facts;
mod lists;
mod network;
mod page;
mod published;
mod records;
mod rendered;
mod report;
mod run;
mod section;
mod sequence;
mod suite;
mod unoseg_masks;
pub mod verify;
mod view_features;
mod view_list;
mod view_pairs;

pub use ablation::INGREDIENTS;
pub use detection_source::DetectionSource;
pub use error::BenchError;
pub use facts::ListFacts;
pub use lists::{ListRequest, PreparedList};
pub use network::{Network, Switches};
pub use sequence::{SequenceRun, run_sequence, sequence_table};
pub use suite::{Method, Suite};
pub use unoseg_masks::UnoSegMasks;
pub use view_features::{FeatureSource, PairAreas, features_table, measure_features};
pub use view_list::OwnMasks;
pub use view_pairs::{PairResult, PairsRun, Verdict, pairs_table, run_pairs};

#[cfg(test)]
mod tests;
