//! Asking a long computation from outside to keep what it has and stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Shared between a computation and whoever may stop it.
#[derive(Debug, Default)]
pub struct Interrupt {
    requested: AtomicBool,
}

impl Interrupt {
    /// Asks the computation to stop. False when it was asked before.
    pub fn request(&self) -> bool {
        !self.requested.swap(true, Ordering::Relaxed)
    }

    /// Whether the computation was asked to stop.
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }

    /// From now on the first Ctrl-C, SIGTERM or SIGHUP calls `first` and is a request, a second one ends the process at
    /// once with 128 plus its number. A SIGHUP that the caller ignores (`nohup`) stays ignored.
    #[cfg(feature = "signals")]
    pub fn on_signals(self: &std::sync::Arc<Self>, first: impl Fn() + Send + 'static) -> std::io::Result<()> {
        let interrupt = self.clone();
        watch(move |signal| match interrupt.request() {
            true => first(),
            false => std::process::exit(128 + signal),
        })
    }
}

/// Calls `handler` with the number of every signal that asks the process to end, on a thread of its own.
#[cfg(all(feature = "signals", unix))]
fn watch(handler: impl Fn(i32) + Send + 'static) -> std::io::Result<()> {
    use signal_hook::{
        consts::{SIGHUP, SIGINT, SIGTERM},
        iterator::Signals,
    };

    let ends =
        [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|&signal| signal != SIGHUP || !is_ignored(signal));
    let mut signals = Signals::new(ends)?;
    std::thread::Builder::new().name("signals".into()).spawn(move || signals.forever().for_each(handler))?;
    Ok(())
}

#[cfg(all(feature = "signals", not(unix)))]
fn watch(handler: impl Fn(i32) + Send + 'static) -> std::io::Result<()> {
    const SIGINT: i32 = 2;
    ctrlc::set_handler(move || handler(SIGINT)).map_err(std::io::Error::other)
}

/// Whether the process was started with this signal ignored, as far as `/proc` tells.
#[cfg(all(feature = "signals", unix))]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask =
        status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_first_request_is_new() {
        let interrupt = Interrupt::default();
        assert!(!interrupt.is_requested());
        assert!(interrupt.request() && interrupt.is_requested());
        assert!(!interrupt.request() && interrupt.is_requested());
    }
}
