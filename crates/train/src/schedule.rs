//! Learning rate over a run: linear warm-up, then half a cosine down to zero (`docs/network.md`, section 8).

use std::time::Duration;

use unopose_core::config::TrainConfig;

/// Learning rate as a function of the position in the run, measured in steps.
#[derive(Clone, Debug)]
pub struct Schedule {
    peak: f64,
    warmup_factor: f64,
    warmup_steps: f64,
    steps: f64,
}

impl Schedule {
    /// Warm-up and decay as configured.
    pub fn new(config: &TrainConfig) -> Self {
        Self {
            peak: config.learning_rate,
            warmup_factor: config.warmup_factor,
            warmup_steps: config.warmup_steps as f64,
            steps: config.steps as f64,
        }
    }

    /// Learning rate at `position` steps (may be fractional) from the start.
    pub fn learning_rate(&self, position: f64) -> f64 {
        let factor = if position < self.warmup_steps {
            self.warmup_factor + (1.0 - self.warmup_factor) * position / self.warmup_steps
        } else {
            let share = (position - self.warmup_steps) / (self.steps - self.warmup_steps);
            0.5 * (1.0 + (std::f64::consts::PI * share.clamp(0.0, 1.0)).cos())
        };
        self.peak * factor
    }
}

/// A limit on the time of one call (`--minutes`).
///
/// A run that will be cut off should still end at a small learning rate. So the time that has passed also moves the
/// position: the part of the schedule that is left when the call begins is spread over the time it has. A later call
/// resumes from the number of steps taken, at the learning rate of that step. Runs without a limit depend on steps
/// alone and are reproducible.
#[derive(Clone, Debug)]
pub struct TimeBudget {
    /// Time for training, data generation and validation already deducted.
    pub training: Duration,
    /// Steps taken before this call.
    pub first_step: u64,
}

impl TimeBudget {
    /// Share of the budget used, in [0, 1].
    pub fn used(&self, elapsed: Duration) -> f64 {
        if self.training.is_zero() {
            return 1.0;
        }
        (elapsed.as_secs_f64() / self.training.as_secs_f64()).min(1.0)
    }

    /// Position in a schedule of `steps`, for the step that begins after `elapsed`.
    pub fn position(&self, step: u64, steps: u64, elapsed: Duration) -> f64 {
        let first = self.first_step as f64;
        (step as f64).max(first + (steps as f64 - first) * self.used(elapsed))
    }

    /// Factor on the learning rate: the compressed warm-up may be over in no time, and a later call begins high.
    pub fn ramp(&self, elapsed: Duration) -> f64 {
        (self.used(elapsed) / RAMP_SHARE).min(1.0)
    }
}

/// Share of the time in which a limited call raises its learning rate from zero.
const RAMP_SHARE: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;

    fn release() -> Schedule {
        Schedule::new(&TrainConfig::default())
    }

    #[test]
    fn warm_up_rises_linearly_from_a_thousandth() {
        let s = release();
        for (step, expected) in
            [(0.0, 1e-7), (500.0, 1e-4 * (0.001 + 0.999 * 0.5)), (999.0, 1e-4 * (0.001 + 0.999 * 0.999))]
        {
            assert!((s.learning_rate(step) - expected).abs() < 1e-15, "step {step}");
        }
    }

    #[test]
    fn cosine_falls_from_the_peak_to_zero() {
        let s = release();
        assert!((s.learning_rate(1000.0) - 1e-4).abs() < 1e-15);
        assert!((s.learning_rate(1000.0 + 187_340.0 / 2.0) - 0.5e-4).abs() < 1e-12);
        // A quarter of the way: (1 + cos 45 deg) / 2.
        let quarter = 0.5 * (1.0 + std::f64::consts::FRAC_1_SQRT_2) * 1e-4;
        assert!((s.learning_rate(1000.0 + 187_340.0 / 4.0) - quarter).abs() < 1e-12);
        assert!(s.learning_rate(188_340.0).abs() < 1e-15);
    }

    #[test]
    fn a_time_budget_compresses_what_is_left() {
        let budget = TimeBudget { training: Duration::from_secs(100), first_step: 200 };
        assert_eq!(budget.position(200, 1000, Duration::ZERO), 200.0);
        assert_eq!(budget.position(210, 1000, Duration::from_secs(50)), 600.0);
        assert_eq!(budget.position(700, 1000, Duration::from_secs(50)), 700.0);
        assert_eq!(budget.position(300, 1000, Duration::from_secs(500)), 1000.0);
        let ramp = |ms| budget.ramp(Duration::from_millis(ms));
        assert_eq!((ramp(0), ramp(2500), ramp(5000), ramp(90_000)), (0.0, 0.5, 1.0, 1.0));
    }
}
