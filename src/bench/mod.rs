//! Methods side by side on the targets of a dataset.
//!
//! [`run_method`] estimates every target with one [`PairEstimator`](crate::registration::PairEstimator), pair by pair,
//! and keeps each result, so that a run that was stopped goes on where it was; [`Comparison`] scores the methods with
//! confidence intervals and paired differences, and [`write_report`] writes the table as Markdown, CSV, JSON and a page.

mod comparison;
mod error;
mod examples;
mod page;
mod published;
mod records;
mod run;
mod tables;

pub use comparison::{Comparison, Difference, MethodScore};
pub use error::BenchError;
pub use examples::Examples;
pub use published::{PublishedRow, published_rows};
pub use records::{PairKey, PairOutcome, PairRecord, Records};
pub use run::{MethodRun, run_method};
pub use tables::write_report;

#[cfg(test)]
mod tests;
