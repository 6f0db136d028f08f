//! Progress of long steps: a bar on a terminal, a line now and then elsewhere.

use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

const LINE_EVERY: Duration = Duration::from_secs(20);

/// A counter with rate and time left.
pub struct Progress {
    label: &'static str,
    bar: ProgressBar,
    start: Instant,
    /// Position when this call began; the rate counts from there.
    first: u64,
    total: u64,
    last_line: Instant,
    limit: Option<Duration>,
}

impl Progress {
    pub fn new(label: &'static str, first: u64, total: u64) -> Self {
        let bar = ProgressBar::new(total).with_position(first);
        let template = "{prefix} {bar:28} {pos}/{len} {msg}";
        bar.set_style(
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.set_prefix(label);
        Self { label, bar, start: Instant::now(), first, total, last_line: Instant::now(), limit: None }
    }

    /// The step ends after `limit` from now, whatever its count.
    pub fn limited(mut self, limit: Option<Duration>) -> Self {
        self.limit = limit;
        self
    }

    /// Shows `done` of the total with rate, time left and `note`.
    pub fn set(&mut self, done: u64, note: &str) {
        let elapsed = self.start.elapsed();
        let message = self.describe(done, elapsed, note);
        self.bar.set_position(done);
        self.bar.set_message(message.clone());
        if self.bar.is_hidden() && self.last_line.elapsed() >= LINE_EVERY {
            self.last_line = Instant::now();
            eprintln!("{} {done}/{} {message}", self.label, self.total);
        }
    }

    /// Prints a line above the bar.
    pub fn line(&self, text: &str) {
        if self.bar.is_hidden() { eprintln!("{text}") } else { self.bar.println(text) }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn describe(&self, done: u64, elapsed: Duration, note: &str) -> String {
        let taken = done.saturating_sub(self.first);
        let mut parts = Vec::new();
        if taken > 0 {
            let per_item = elapsed.as_secs_f64() / taken as f64;
            parts.push(if per_item > 0.5 {
                format!("{per_item:.2} s each")
            } else {
                format!("{:.1}/s", 1.0 / per_item.max(1e-9))
            });
            let by_count = Duration::from_secs_f64(per_item * self.total.saturating_sub(done) as f64);
            let left = self.limit.map_or(by_count, |limit| by_count.min(limit.saturating_sub(elapsed)));
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
        let progress = Progress::new("training", 100, 200);
        let text = progress.describe(150, Duration::from_secs(100), "loss 3.2");
        assert_eq!(text, "2.00 s each, 2 minutes left, loss 3.2");
        let limited = Progress::new("training", 100, 200).limited(Some(Duration::from_secs(130)));
        assert_eq!(limited.describe(150, Duration::from_secs(100), ""), "2.00 s each, 30 seconds left");
        assert_eq!(progress.describe(100, Duration::ZERO, ""), "");
    }
}
