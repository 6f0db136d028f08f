//! Progress of a long step on stderr: a bar on a terminal, a line now and then elsewhere.

use std::{
    sync::Mutex,
    time::{Duration, Instant},
};
use unopose_cli::tell;

use indicatif::{ProgressBar, ProgressStyle};

const LINE_EVERY: Duration = Duration::from_secs(20);

/// A bar with rate and time left, usable from any thread.
pub struct ProgressDisplay {
    label: String,
    bar: ProgressBar,
    start: Instant,
    last_line: Mutex<Instant>,
}

impl ProgressDisplay {
    pub fn new(label: impl Into<String>) -> Self {
        let label = label.into();
        let bar = ProgressBar::new(0);
        let template = "{prefix} {bar:28} {pos}/{len} {per_sec}, {eta} left";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.set_prefix(label.clone());
        Self { label, bar, start: Instant::now(), last_line: Mutex::new(Instant::now()) }
    }

    /// Shows `done` of `total`; what was shown before may be further.
    pub fn set(&self, done: usize, total: usize) {
        self.bar.set_length(total as u64);
        self.bar.set_position(self.bar.position().max(done as u64));
        let Ok(mut last_line) = self.last_line.lock() else { return };
        if self.bar.is_hidden() && last_line.elapsed() >= LINE_EVERY {
            *last_line = Instant::now();
            let per_item = self.start.elapsed().as_secs_f64() / done.max(1) as f64;
            let left = per_item * total.saturating_sub(done) as f64;
            tell!("{} {done}/{total}, {per_item:.2} s each, {left:.0} s left", self.label);
        }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
