//! What is wrong with a view before a pose is estimated: units, missing depth, registration of colour and depth, masks.
//!
//! [`findings`] looks at everything that one masked view tells; [`quick_findings`] is the part that costs one pass over the
//! mask, for every estimate. [`pair_finding`] compares the sizes in reference and query, [`examine_dataset`] looks at samples
//! of a whole dataset, [`write_picture`] draws what was found. Every finding says how bad it is ([`Level`]) and what to do.
//! Limits are those of depth cameras and of objects on tables, wide enough for sensor noise.

mod alignment;
mod camera;
mod dataset;
mod finding;
mod jumps;
mod mask_fit;
mod object;
mod picture;
mod quick;

pub use dataset::{CheckSummary, DatasetReport, SampledInstance, Sampling, examine_dataset};
pub use finding::{Check, Finding, Level};
pub use object::MaskedObject;
pub use picture::{bar_length, write_picture};
pub use quick::{Expected, pair_finding, quick_findings, unit_finding};

use unopose_core::frame::{MaskedView, RgbdFrame};

/// All findings of a masked object. Colours, depth and mask are equally large.
pub fn findings(view: MaskedView<'_>, expected: &Expected) -> Vec<Finding> {
    let lines = jumps::Lines::of(view.frame);
    let mut findings = quick_findings(view, expected);
    findings.push(alignment::alignment_finding(view.frame, &lines, Some(view.mask)));
    findings.push(mask_fit::mask_finding(view, &lines));
    findings
}

/// What can be said without a mask.
pub fn frame_findings(frame: &RgbdFrame) -> Vec<Finding> {
    let lines = jumps::Lines::of(frame);
    vec![camera::camera_finding(frame), alignment::alignment_finding(frame, &lines, None)]
}

#[cfg(test)]
mod tests;
