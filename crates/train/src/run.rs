//! The training loop.

use std::{
    ops::ControlFlow,
    sync::Arc,
    time::{Duration, Instant},
};

use unopose_core::{config::Config, files::remove_part_files, folder_lock::FolderLock};
use unopose_nn::device::require_precision;
use unopose_pairs::data::BatchStream;

use super::{
    TrainError, bad_batch,
    best::Best,
    datasets::Datasets,
    figures, folder,
    journal::{Event, Journal, StepRecord, ValidationRecord},
    observer::{Phase, PhaseExtent},
    optimization::Optimization,
    options::{StopReason, TrainOptions, TrainOutcome},
    pose_task::PoseTask,
    replicas::{BatchGradients, TOTAL},
    schedule::{Schedule, TimeBudget},
    state::{self, RunState},
    task::{SampleOf, Task},
};

/// Trains the pose network in `options.out`, or resumes the run there.
pub fn train(config: &Config, options: &TrainOptions) -> Result<TrainOutcome, TrainError> {
    run(config, options, |datasets| PoseTask::new(config, options, datasets))
}

/// Runs the task that `open` makes of the training and validation sets.
pub(super) fn run<T: Task>(
    config: &Config,
    options: &TrainOptions,
    open: impl FnOnce(Datasets) -> Result<T, TrainError>,
) -> Result<TrainOutcome, TrainError> {
    let start = Instant::now();
    require_precision(&options.device, config.train.precision)?;
    let _lock = FolderLock::exclusive(&options.out)?;
    remove_part_files(&options.out)?;
    if !options.fresh {
        folder::require_same_network(config, &options.out)?;
        if let Some(step) = folder::finished_step(config, &options.out)? {
            let events = Journal::read(&options.out.join("metrics.jsonl"))?;
            return Ok(TrainOutcome {
                stop_reason: StopReason::AlreadyFinished,
                step,
                validations: validations(&events),
            });
        }
    }
    match Datasets::open_or_generate(config, options, start)? {
        ControlFlow::Continue(datasets) => Run::start(config, options, open(datasets)?, start)?.run(),
        ControlFlow::Break(stop_reason) => {
            let earlier = if options.fresh { None } else { state::read_state(&options.out)? };
            let step = earlier.map_or(0, |(step, _)| step);
            Ok(TrainOutcome { stop_reason, step, validations: Vec::new() })
        }
    }
}

/// A run in progress.
struct Run<'a, T: Task> {
    config: &'a Config,
    options: &'a TrainOptions,
    task: T,
    optimization: Optimization<T::Model>,
    schedule: Schedule,
    journal: Journal,
    best: Best,
    state: RunState,
    /// Start of the call.
    start: Instant,
    /// Training time of earlier calls, seconds.
    earlier_s: f64,
    last_checkpoint: Instant,
    last_validation: Instant,
    validation_time: Duration,
    validated_step: Option<u64>,
}

impl<'a, T: Task> Run<'a, T> {
    fn start(
        config: &'a Config,
        options: &'a TrainOptions,
        task: T,
        start: Instant,
    ) -> Result<Self, TrainError> {
        let mut optimization = Optimization::new(task.network(), &config.train);
        let restored = match options.fresh {
            true => None,
            false => state::restore(&options.out, &mut optimization, &config.model, options.reset_optimizer)?,
        };
        if restored.is_none()
            && let Some(model) = task.initial_weights(optimization.model())?
        {
            optimization = Optimization::new(model, &config.train);
        }
        // An earlier run goes only when the new one has all it needs.
        if options.fresh {
            state::clear(&options.out)?;
        }
        folder::write_config(config, &options.out)?;
        let at = restored.as_ref().map(|_| optimization.step());
        let (journal, events) = Journal::open(&options.out.join("metrics.jsonl"), at)?;
        let best = Best::open(&options.out, &events)?;
        let state = restored.unwrap_or_default();
        // Weights of a validation that are lost are validated again.
        let validated_step = validations(&events).last().map(|v| v.step).filter(|_| best.exists());
        Ok(Self {
            config,
            options,
            task,
            optimization,
            schedule: Schedule::new(&config.train),
            journal,
            best,
            earlier_s: state.elapsed_s,
            state,
            start,
            last_checkpoint: Instant::now(),
            last_validation: Instant::now(),
            validation_time: Duration::ZERO,
            validated_step,
        })
    }

    fn run(mut self) -> Result<TrainOutcome, TrainError> {
        let train = &self.config.train;
        let first_step = self.optimization.step();
        let due = std::mem::take(&mut self.state.validation_due) || first_step == 0;
        if due && self.validated_step != Some(first_step) {
            self.validate()?;
            self.save()?;
        }
        let reserve = self.validation_time.mul_f64(1.3) + Duration::from_secs(3);
        let training_start = Instant::now();
        let budget = self.options.time_limit.map(|limit| TimeBudget {
            training: limit.saturating_sub(self.start.elapsed()).saturating_sub(reserve),
            first_step,
        });
        let sampler = self.task.training_sampler()?;
        let mut batches = BatchStream::new(
            Arc::new(sampler),
            self.state.next_pair,
            train.batch_size,
            workers(train.workers),
            train.prefetch,
        );
        let observer = self.options.observer.clone();
        let extent = PhaseExtent::new(first_step, train.steps);
        observer.begin(Phase::Training, extent.with_time_limit(budget.as_ref().map(|b| b.training)));
        let mut stop_reason = StopReason::Finished;
        while self.optimization.step() < train.steps {
            let enough = self.options.stop_at.is_some_and(|stop| self.optimization.step() >= stop);
            if enough || self.options.interrupt.is_requested() {
                stop_reason = StopReason::Interrupted;
                break;
            }
            let elapsed = training_start.elapsed();
            if budget.as_ref().is_some_and(|b| b.used(elapsed) >= 1.0) {
                stop_reason = StopReason::TimeUp;
                break;
            }
            let step = self.optimization.step();
            let (position, ramp) = match &budget {
                Some(budget) => (budget.position(step, train.steps, elapsed), budget.ramp(elapsed)),
                None => (step as f64, 1.0),
            };
            let record = self.step(&mut batches, ramp * self.schedule.learning_rate(position))?;
            let note = format!("loss {:.3}, rate {:.1e}", record.loss, record.learning_rate);
            observer.advance(Phase::Training, record.step, &note);
            self.journal.append(&Event::Step(record))?;
            self.validate_and_save_when_due()?;
        }
        observer.end(Phase::Training);
        self.finish(stop_reason)
    }

    /// Validation and checkpoints that have become due.
    fn validate_and_save_when_due(&mut self) -> Result<(), TrainError> {
        let train = &self.config.train;
        let step = self.optimization.step();
        let minutes = self.last_validation.elapsed().as_secs_f64() / 60.0;
        let due = step.is_multiple_of(train.validate_every)
            || (train.validate_minutes > 0.0 && minutes >= train.validate_minutes);
        if due
            && step < train.steps
            && let Some(record) = self.validate()?
        {
            self.options.observer.line(&format!("step {step}: {}", record.describe()));
        }
        if due || self.last_checkpoint.elapsed().as_secs_f64() >= train.checkpoint_seconds {
            self.save()?;
        }
        Ok(())
    }

    fn finish(mut self, mut stop_reason: StopReason) -> Result<TrainOutcome, TrainError> {
        let step = self.optimization.step();
        if stop_reason != StopReason::Interrupted
            && self.validated_step != Some(step)
            && self.validate()?.is_none()
        {
            stop_reason = StopReason::Interrupted;
        }
        self.state.finished = stop_reason == StopReason::Finished;
        self.save()?;
        let out = &self.options.out;
        let events = Journal::read(&out.join("metrics.jsonl"))?;
        figures::write_training_curves(&out.join("curves.svg"), &events)?;
        if stop_reason != StopReason::Interrupted {
            self.task.write_pictures(&self.optimization.deployed(), out)?;
        }
        Ok(TrainOutcome { stop_reason, step, validations: validations(&events) })
    }

    fn step(
        &mut self,
        batches: &mut BatchStream<T::Sampler>,
        learning_rate: f64,
    ) -> Result<StepRecord, TrainError> {
        let train = &self.config.train;
        let mut record = StepRecord { learning_rate, ..StepRecord::default() };
        for _ in 0..train.accumulation {
            let samples: Vec<SampleOf<T>> =
                batches.next().ok_or_else(|| TrainError::Unusable("the training samples ended".into()))??;
            let BatchGradients { losses, gradients } =
                self.task.gradients(self.optimization.model(), &samples);
            self.require_finite(&losses, &samples)?;
            for (name, values) in &losses {
                let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64;
                *record.terms.entry(name.clone()).or_insert(0.0) += mean / train.accumulation as f64;
            }
            gradients.into_iter().for_each(|gradients| self.optimization.add(gradients));
            self.state.next_pair += samples.len() as u64;
        }
        record.loss = record.terms.remove(TOTAL).unwrap_or(f64::NAN);
        record.gradient_norm = self.optimization.apply(learning_rate);
        record.step = self.optimization.step();
        record.elapsed_s = self.elapsed_s();
        Ok(record)
    }

    /// A loss that is not finite ends the run with its batch in a file.
    fn require_finite(
        &self,
        losses: &[(String, Vec<f32>)],
        samples: &[SampleOf<T>],
    ) -> Result<(), TrainError> {
        let bad = losses.iter().find_map(|(name, v)| v.iter().find(|v| !v.is_finite()).map(|v| (name, *v)));
        let Some((term, value)) = bad else { return Ok(()) };
        let step = self.optimization.step() + 1;
        let batch = bad_batch::save(&self.task, &self.options.out, step, samples, losses)?;
        Err(TrainError::NonFiniteLoss { step, value: value.into(), term: term.clone(), batch })
    }

    /// `None` when interrupted; the next call begins with it.
    fn validate(&mut self) -> Result<Option<ValidationRecord>, TrainError> {
        let start = Instant::now();
        let model = self.optimization.deployed();
        let record = self.task.validate(&model)?;
        self.state.validation_due = record.is_none();
        let Some(mut record) = record else { return Ok(None) };
        record.step = self.optimization.step();
        record.elapsed_s = self.elapsed_s();
        // In this order: a validation in the journal has left its weights.
        self.best.offer(&model, self.config, &record)?;
        self.journal.append(&Event::Validation(record.clone()))?;
        self.validated_step = Some(record.step);
        self.last_validation = Instant::now();
        self.validation_time = start.elapsed();
        Ok(Some(record))
    }

    fn save(&mut self) -> Result<(), TrainError> {
        self.journal.sync()?;
        self.state.elapsed_s = self.elapsed_s();
        state::save(&self.options.out, &self.optimization, self.config, &self.state)?;
        self.last_checkpoint = Instant::now();
        Ok(())
    }

    fn elapsed_s(&self) -> f64 {
        self.earlier_s + self.start.elapsed().as_secs_f64()
    }
}

/// Threads for data preparation.
fn workers(configured: usize) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    if configured == 0 { cores() } else { configured }
}

fn validations(events: &[Event]) -> Vec<ValidationRecord> {
    let of = |event: &Event| match event {
        Event::Validation(record) => Some(record.clone()),
        Event::Step(_) => None,
    };
    events.iter().filter_map(of).collect()
}
