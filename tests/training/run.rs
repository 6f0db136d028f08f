//! Whole training runs at the smallest size: the loss falls, resuming is exact, failures are clean.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use unopose_core::config::Config;
use unopose_nn::checkpoint::TensorFile;
use unopose_train::{
    Event, Journal, Phase, PhaseExtent, StopReason, TrainError, TrainObserver, TrainOptions, train,
};

use super::small_runs::{bits, config, losses, options};

/// Keeps what a run tells.
#[derive(Default)]
struct Recorder {
    /// How often each phase began and ended.
    phases: Mutex<BTreeMap<Phase, [usize; 2]>>,
    steps: Mutex<Vec<u64>>,
    lines: Mutex<Vec<String>>,
}

impl TrainObserver for Recorder {
    fn begin(&self, phase: Phase, _: PhaseExtent) {
        self.phases.lock().unwrap().entry(phase).or_default()[0] += 1;
    }

    fn advance(&self, phase: Phase, done: u64, _: &str) {
        if phase == Phase::Training {
            self.steps.lock().unwrap().push(done);
        }
    }

    fn end(&self, phase: Phase) {
        self.phases.lock().unwrap().entry(phase).or_default()[1] += 1;
    }

    fn line(&self, text: &str) {
        self.lines.lock().unwrap().push(text.into());
    }
}

#[test]
fn the_loss_falls_and_a_second_call_says_finished() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=60"]);
    let recorder = Arc::new(Recorder::default());
    let options = TrainOptions { observer: recorder.clone(), ..options(folder.path(), "run") };
    let outcome = train(&config, &options).unwrap();
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Finished, 60));
    let losses = losses(&options.out);
    assert_eq!(losses.len(), 60);
    let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
    let (first, last) = (mean(&losses[..10]), mean(&losses[50..]));
    assert!(last < 0.9 * first, "mean loss of the first ten steps {first}, of the last ten {last}");
    let validation: Vec<u64> = outcome.validations.iter().map(|v| v.step).collect();
    assert_eq!(validation, [0, 20, 40, 60]);
    assert!(outcome.validations[3].loss < outcome.validations[0].loss);
    let once = [
        Phase::TrainingModels,
        Phase::TrainingImages,
        Phase::ValidationModels,
        Phase::ValidationImages,
        Phase::Training,
    ];
    let told = once.into_iter().map(|phase| (phase, [1, 1])).chain([(Phase::Validation, [4, 4])]);
    assert_eq!(*recorder.phases.lock().unwrap(), told.collect());
    assert_eq!(*recorder.steps.lock().unwrap(), (1..=60).collect::<Vec<u64>>());
    let lines = recorder.lines.lock().unwrap();
    assert!(lines.len() == 2 && lines[1].starts_with("step 40: loss "), "{lines:?}");

    for file in ["best.safetensors", "last.safetensors", "curves.svg", "poses.png", "state-60/optimizer.bpk"]
    {
        assert!(options.out.join(file).exists(), "{file}");
    }
    let resolved = Config::load(&options.out.join("config.toml"), &[]).unwrap();
    assert_eq!(resolved, config);
    let weights = bits(&options.out.join("last.safetensors"));
    let again = train(&config, &options).unwrap();
    assert_eq!((again.stop_reason, again.step), (StopReason::AlreadyFinished, 60));
    assert_eq!(bits(&options.out.join("last.safetensors")), weights);
}

#[test]
fn pairs_that_the_print_decides_are_reported_apart() {
    let folder = tempfile::tempdir().unwrap();
    let validated = |name: &str, printed: &str| {
        let set = format!("synth.printed={printed}");
        let named = format!("name={name:?}");
        let config = config(&["train.steps=1", "train.warmup_steps=0", &set, &named]);
        train(&config, &options(folder.path(), name)).unwrap().validations[0].clone()
    };
    assert_eq!(validated("plain", "0.0").print_within_15deg, None);
    let record = validated("printed", "1.0");
    let share = record.print_within_15deg.unwrap();
    assert!((0.0..=1.0).contains(&share), "{share}");
    assert!(record.describe().contains("of those that the print decides"), "{}", record.describe());
}

#[test]
fn an_interrupted_run_resumes_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=12", "train.accumulation=2", "train.validate_every=5"]);
    let whole = options(folder.path(), "whole");
    train(&config, &whole).unwrap();

    let mut parts = options(folder.path(), "parts");
    parts.stop_at = Some(6);
    let outcome = train(&config, &parts).unwrap();
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Interrupted, 6));
    parts.stop_at = None;
    assert_eq!(train(&config, &parts).unwrap().stop_reason, StopReason::Finished);

    for file in ["last.safetensors", "best.safetensors", "state-12/average.safetensors"] {
        assert_eq!(bits(&parts.out.join(file)), bits(&whole.out.join(file)), "{file}");
    }
    assert_eq!(losses(&parts.out), losses(&whole.out));
}

#[test]
fn a_time_limit_ends_the_run_cleanly_at_a_small_learning_rate() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=1000000", "train.warmup_steps=100000"]);
    let mut options = options(folder.path(), "run");
    // Generates the data; the limit below is for training.
    options.stop_at = Some(0);
    train(&config, &options).unwrap();
    options.stop_at = None;
    options.time_limit = Some(Duration::from_secs(9));
    let begin = std::time::Instant::now();
    let outcome = train(&config, &options).unwrap();
    assert_eq!(outcome.stop_reason, StopReason::TimeUp);
    assert!(outcome.step > 0 && begin.elapsed() < Duration::from_secs(20), "{:?}", begin.elapsed());
    assert_eq!(outcome.validations.last().unwrap().step, outcome.step);
    let events = Journal::read(&options.out.join("metrics.jsonl")).unwrap();
    let rates: Vec<f64> = events
        .iter()
        .filter_map(|e| if let Event::Step(record) = e { Some(record.learning_rate) } else { None })
        .collect();
    let peak = rates.iter().copied().fold(0.0, f64::max);
    assert!(rates.last().unwrap() < &(0.2 * peak), "{rates:?}");
}

#[test]
fn another_network_in_the_folder_is_refused_and_init_takes_its_weights() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(folder.path(), "run");
    options.stop_at = Some(2);
    train(&config(&[]), &options).unwrap();
    let other = config(&["model.coarse.temperature=0.2"]);
    let error = train(&other, &options).unwrap_err();
    assert!(
        matches!(&error, TrainError::OtherModel { field, .. } if field == "model.coarse.temperature"),
        "{error}"
    );

    let last = options.out.join("last.safetensors");
    let mut tuned = self::options(folder.path(), "tuned");
    tuned.init = Some(last.clone());
    tuned.stop_at = Some(0);
    train(&other, &tuned).unwrap();
    assert_eq!(bits(&tuned.out.join("last.safetensors")), bits(&last));

    options.fresh = true;
    options.stop_at = Some(1);
    assert_eq!(train(&other, &options).unwrap().step, 1);
}

#[test]
fn a_loss_that_is_not_finite_stops_the_run_and_keeps_the_batch() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(folder.path(), "run");
    options.stop_at = Some(3);
    train(&config(&[]), &options).unwrap();
    // A learning rate that blows the weights up within a few steps.
    options.stop_at = None;
    // No file may ask for this.
    let mut config = config(&[]);
    config.train.learning_rate = 1e30;
    let error = train(&config, &options).unwrap_err();
    let TrainError::NonFiniteLoss { step, batch, .. } = &error else { panic!("{error}") };
    assert!(*step > 3 && batch.ends_with(format!("bad-batch-{step}.safetensors")), "{error}");
    let file = TensorFile::read(batch).unwrap();
    assert_eq!(file.tensors["1.query.points"].shape()[..], [96, 3]);
    assert!(file.metadata.contains_key("0.t_query_reference"));
    assert!(file.metadata.keys().any(|key| key.starts_with("loss.")));
}
