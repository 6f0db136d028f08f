//! The probability that an estimated pose is right, and reasons to doubt it.
//!
//! A [`Calibration`] is a logistic regression on the [`Evidence`] of an estimate, fitted by [`Calibration::fit`] to pairs
//! whose truth is known (Platt 1999). No weight is negative, so more overlap or a better fit never lowers the
//! confidence. It belongs to the weights it was fitted with and travels in their checkpoint's metadata.

mod calibration;
mod evidence;
mod fit;

pub use calibration::{Calibration, Confidence, PoseCriterion, Reason, Term};
pub(super) use evidence::Support;
pub use evidence::{Evidence, Feature, ReasonKind};
pub use fit::logistic_regression;

#[cfg(test)]
mod tests;
