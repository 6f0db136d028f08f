//! Numbers as the cells of tables.

use unopose_eval::metrics::Interval;

/// A share as percent with one digit.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// An interval of shares, percent.
pub(crate) fn span(interval: &Interval) -> String {
    format!("{} .. {}", percent(interval.low), percent(interval.high))
}

/// Seconds to the millisecond; negative ones are unknown.
pub(crate) fn seconds(seconds: f64) -> String {
    if seconds >= 0.0 { format!("{seconds:.3}") } else { "unknown".into() }
}
