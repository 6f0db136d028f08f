//! Batches prepared ahead by worker threads, delivered in order.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

use super::DataError;

/// Where the samples of a stream come from.
pub trait SampleSource: Send + Sync + 'static {
    /// A prepared sample.
    type Sample: Send + 'static;

    /// Augmented sample number `index`, a pure function of it.
    fn training_sample(&self, index: u64) -> Result<Self::Sample, DataError>;
}

/// Endless batches of augmented samples. Batch b holds the samples `start + b * batch ..`. After an error the stream
/// ends. Dropping it stops the workers.
pub struct BatchStream<S: SampleSource> {
    shared: Arc<Shared<S::Sample>>,
    workers: Vec<JoinHandle<()>>,
    batch: usize,
    /// First sample of the next batch.
    next: u64,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    /// A sample was finished.
    finished: Condvar,
    /// The window moved or the stream was dropped.
    window_moved: Condvar,
}

struct State<T> {
    /// Next sample to be claimed by a worker.
    claim: u64,
    /// Samples below this may be prepared.
    window_end: u64,
    done: BTreeMap<u64, Result<T, DataError>>,
    stopped: bool,
}

impl<S: SampleSource> BatchStream<S> {
    /// Starts `workers` threads (at least 1) that keep up to `ahead` batches beyond the current one prepared, from
    /// sample `start_index` on.
    pub fn new(sampler: Arc<S>, start_index: u64, batch: usize, workers: usize, ahead: usize) -> Self {
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
                std::thread::spawn(move || shared.work(&*sampler))
            })
            .collect();
        Self { shared, workers, batch, next: start_index }
    }

    /// First sample of the next batch: where a resumed stream starts.
    pub fn position(&self) -> u64 {
        self.next
    }
}

impl<S: SampleSource> Iterator for BatchStream<S> {
    type Item = Result<Vec<S::Sample>, DataError>;

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

impl<S: SampleSource> Drop for BatchStream<S> {
    fn drop(&mut self) {
        self.shared.lock().stopped = true;
        self.shared.window_moved.notify_all();
        for worker in self.workers.drain(..) {
            // A worker's panic was already delivered as an error.
            let _ = worker.join();
        }
    }
}

impl<T: Send> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work<S: SampleSource<Sample = T>>(&self, sampler: &S) {
        // A pool of its own keeps the geometry out of the global pool, where training runs.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        while let Some(index) = self.claim() {
            let prepare = || sampler.training_sample(index);
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
