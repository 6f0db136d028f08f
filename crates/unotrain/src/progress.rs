//! Progress of a run on stderr: a bar per phase on a terminal, a line now and then elsewhere.

use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use unopose_cli::tell;
use unopose_train::{Phase, PhaseExtent, TrainObserver};

const LINE_EVERY: Duration = Duration::from_secs(20);

/// The bars of the phases that have begun and not ended.
#[derive(Default)]
pub struct ProgressBars(Mutex<BTreeMap<Phase, Bar>>);

impl ProgressBars {
    fn bars(&self) -> MutexGuard<'_, BTreeMap<Phase, Bar>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl TrainObserver for ProgressBars {
    fn begin(&self, phase: Phase, extent: PhaseExtent) {
        self.bars().insert(phase, Bar::new(phase.label(), extent));
    }

    fn advance(&self, phase: Phase, done: u64, note: &str) {
        if let Some(bar) = self.bars().get_mut(&phase) {
            bar.set(done, note);
        }
    }

    fn end(&self, phase: Phase) {
        if let Some(bar) = self.bars().remove(&phase) {
            bar.finish();
        }
    }

    /// Above the bar of the training, if there is one.
    fn line(&self, text: &str) {
        match self.bars().get(&Phase::Training) {
            Some(bar) if !bar.bar.is_hidden() => bar.bar.println(text),
            _ => tell!("{text}"),
        }
    }
}

/// A counter with rate and time left.
struct Bar {
    label: &'static str,
    bar: ProgressBar,
    start: Instant,
    /// The rate counts from its first item.
    extent: PhaseExtent,
    last_line: Instant,
}

impl Bar {
    fn new(label: &'static str, extent: PhaseExtent) -> Self {
        let bar = ProgressBar::new(extent.total).with_position(extent.first);
        let template = "{prefix} {bar:28} {pos}/{len} {msg}";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.set_prefix(label);
        Self { label, bar, start: Instant::now(), extent, last_line: Instant::now() }
    }

    /// Shows `done` of the total with rate, time left and `note`.
    fn set(&mut self, done: u64, note: &str) {
        let elapsed = self.start.elapsed();
        let message = self.describe(done, elapsed, note);
        self.bar.set_position(done);
        self.bar.set_message(message.clone());
        if self.bar.is_hidden() && self.last_line.elapsed() >= LINE_EVERY {
            self.last_line = Instant::now();
            tell!("{} {done}/{} {message}", self.label, self.extent.total);
        }
    }

    /// Removes the bar.
    fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn describe(&self, done: u64, elapsed: Duration, note: &str) -> String {
        let taken = done.saturating_sub(self.extent.first);
        let mut parts = Vec::new();
        if taken > 0 {
            let per_item = elapsed.as_secs_f64() / taken as f64;
            parts.push(if per_item > 0.5 {
                format!("{per_item:.2} s each")
            } else {
                format!("{:.1}/s", 1.0 / per_item.max(1e-9))
            });
            let by_count = Duration::from_secs_f64(per_item * self.extent.total.saturating_sub(done) as f64);
            let within = |limit: Duration| by_count.min(limit.saturating_sub(elapsed));
            let left = self.extent.time_limit.map_or(by_count, within);
            parts.push(format!("{} left", HumanDuration(Duration::from_secs(left.as_secs()))));
        }
        if !note.is_empty() {
            parts.push(note.to_owned());
        }
        parts.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_time_left_count_from_where_this_call_began() {
        let extent = PhaseExtent::new(100, 200);
        let bar = Bar::new("training", extent);
        let text = bar.describe(150, Duration::from_secs(100), "loss 3.2");
        assert_eq!(text, "2.00 s each, 2 minutes left, loss 3.2");
        let limited = Bar::new("training", extent.with_time_limit(Some(Duration::from_secs(130))));
        assert_eq!(limited.describe(150, Duration::from_secs(100), ""), "2.00 s each, 30 seconds left");
        assert_eq!(bar.describe(100, Duration::ZERO, ""), "");
    }
}
