//! Batches prepared ahead by worker threads, delivered in order.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

use super::{DataError, PairSampler, TrainSample};

/// Endless batches of augmented samples. Batch b holds the samples `start + b * batch ..`. After an error the stream
/// ends. Dropping it stops the workers.
pub struct BatchStream {
    shared: Arc<Shared>,
    workers: Vec<JoinHandle<()>>,
    batch: usize,
    /// First sample of the next batch.
    next: u64,
}

struct Shared {
    state: Mutex<State>,
    /// A sample was finished.
    finished: Condvar,
    /// The window moved or the stream was dropped.
    window_moved: Condvar,
}

struct State {
    /// Next sample to be claimed by a worker.
    claim: u64,
    /// Samples below this may be prepared.
    window_end: u64,
    done: BTreeMap<u64, Result<TrainSample, DataError>>,
    stopped: bool,
}

impl BatchStream {
    /// Starts `workers` threads (at least 1) that keep up to `ahead` batches beyond the current one prepared, from
    /// sample `start_index` on.
    pub fn new(
        sampler: Arc<PairSampler>,
        start_index: u64,
        batch: usize,
        workers: usize,
        ahead: usize,
    ) -> Self {
        let batch = batch.max(1);
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                claim: start_index,
                window_end: start_index + ((ahead + 1) * batch) as u64,
                done: BTreeMap::new(),
                stopped: false,
            }),
            finished: Condvar::new(),
            window_moved: Condvar::new(),
        });
        let workers = (0..workers.max(1))
            .map(|_| {
                let (shared, sampler) = (shared.clone(), sampler.clone());
                std::thread::spawn(move || shared.work(&sampler))
            })
            .collect();
        Self { shared, workers, batch, next: start_index }
    }

    /// First sample of the next batch: where a resumed stream starts.
    pub fn position(&self) -> u64 {
        self.next
    }
}

impl Iterator for BatchStream {
    type Item = Result<Vec<TrainSample>, DataError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut samples = Vec::with_capacity(self.batch);
        let mut state = self.shared.lock();
        while samples.len() < self.batch {
            if state.stopped {
                return None;
            }
            match state.done.remove(&self.next) {
                Some(Ok(sample)) => {
                    samples.push(sample);
                    self.next += 1;
                    state.window_end += 1;
                    self.shared.window_moved.notify_one();
                }
                Some(Err(error)) => {
                    state.stopped = true;
                    self.shared.window_moved.notify_all();
                    return Some(Err(error));
                }
                None => state = self.shared.finished.wait(state).unwrap_or_else(PoisonError::into_inner),
            }
        }
        Some(Ok(samples))
    }
}

impl Drop for BatchStream {
    fn drop(&mut self) {
        self.shared.lock().stopped = true;
        self.shared.window_moved.notify_all();
        for worker in self.workers.drain(..) {
            // A worker's panic was already delivered as an error.
            let _ = worker.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, sampler: &PairSampler) {
        // A pool of its own keeps the geometry out of the global pool, where training runs.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        while let Some(index) = self.claim() {
            let prepare = || sampler.sample(index, true);
            let prepare = || pool.as_ref().map_or_else(|_| prepare(), |pool| pool.install(prepare));
            let sample = catch_unwind(AssertUnwindSafe(prepare))
                .unwrap_or_else(|panic| Err(DataError::Worker { index, message: message_of(&*panic) }));
            self.lock().done.insert(index, sample);
            self.finished.notify_all();
        }
    }

    /// The next sample number inside the window; `None` when the stream has stopped.
    fn claim(&self) -> Option<u64> {
        let mut state = self.lock();
        loop {
            if state.stopped {
                return None;
            }
            if state.claim < state.window_end {
                state.claim += 1;
                return Some(state.claim - 1);
            }
            state = self.window_moved.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

fn message_of(panic: &(dyn std::any::Any + Send)) -> String {
    panic
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| panic.downcast_ref::<&str>().map(|s| s.to_string()))
        .unwrap_or_else(|| "panic".into())
}
