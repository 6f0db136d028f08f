//! Methods side by side on the targets of a dataset.
//!
//! [`ListRequest`] reads or builds the lists of a protocol; [`Suite`] runs every method on one of them and writes all that
//! is known afterwards. Below it, [`run_method`] estimates the targets pair by pair and keeps each result, so that a run
//! that was stopped goes on where it was; [`Comparison`] scores the methods with confidence intervals and paired
//! differences, and [`write_report`] writes the table as Markdown, CSV, JSON and a page. [`run_sequence`] does the same for
//! phone sequences, which have camera poses instead of models.

mod ablation;
pub mod analysis;
mod cells;
mod comparison;
mod comparison_sections;
mod error;
mod examples;
mod facts;
mod lists;
mod network;
mod own_masks;
mod page;
mod published;
mod records;
mod rendered;
mod report;
mod run;
mod section;
mod sequence;
mod suite;
pub mod verify;

pub use ablation::INGREDIENTS;
pub use comparison::{Comparison, Difference, MethodScore};
pub use error::BenchError;
pub use examples::Examples;
pub use facts::{ListFacts, OverlapBin};
pub use lists::{ListRequest, PreparedList, Segmentation};
pub use network::{Network, Switches};
pub use own_masks::OwnMasks;
pub use published::{
    PublishedAblation, PublishedRow, PublishedTable, published_ablation, published_rows, published_tables,
};
pub use records::{PairKey, PairOutcome, PairRecord, Records};
pub use rendered::render_references;
pub use report::write_report;
pub use run::{MethodRun, run_method};
pub use sequence::{FrameError, SequenceRun, markdown as sequence_table, run_sequence};
pub use suite::{Method, Suite};

#[cfg(test)]
mod tests;
