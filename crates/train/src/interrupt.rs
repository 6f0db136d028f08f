//! Asking a run from outside to save and stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Shared between a run and whoever may stop it (the Ctrl-C handler).
#[derive(Debug, Default)]
pub struct Interrupt {
    requested: AtomicBool,
    training: AtomicBool,
}

impl Interrupt {
    /// Asks the run to save and stop. False when there is nothing to wait for: it was asked before, or it has not begun
    /// to train (finished shards of generated data are kept anyway).
    pub fn request(&self) -> bool {
        let first = !self.requested.swap(true, Ordering::Relaxed);
        first && self.training.load(Ordering::Relaxed)
    }

    /// Whether the run was asked to stop.
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }

    /// From now on an interrupt is worth waiting for.
    pub(super) fn training_begins(&self) {
        self.training.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_first_request_during_training_is_worth_waiting_for() {
        let early = Interrupt::default();
        assert!(!early.request() && early.is_requested());
        let interrupt = Interrupt::default();
        interrupt.training_begins();
        assert!(!interrupt.is_requested());
        assert!(interrupt.request());
        assert!(!interrupt.request());
    }
}
