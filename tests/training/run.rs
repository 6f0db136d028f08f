//! Whole training runs at the smallest size: the loss falls, resuming is exact, failures are clean.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use burn::tensor::Device;
use unopose_core::{config::Config, folder_lock::FolderLock, interrupt::Interrupt};
use unopose_nn::checkpoint::TensorFile;
use unopose_train::{
    Event, Journal, Phase, PhaseExtent, StopReason, TrainError, TrainObserver, TrainOptions, train,
};

fn config(overrides: &[&str]) -> Config {
    let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
    Config::embedded("smoke", &overrides).unwrap()
}

/// Options for a run in `folder/<name>`; all runs of a folder share the data.
pub fn options(folder: &Path, name: &str) -> TrainOptions {
    TrainOptions {
        out: folder.join(name),
        data_root: folder.join("data"),
        init: None,
        fresh: false,
        reset_optimizer: false,
        time_limit: None,
        stop_at: None,
        device: Device::default(),
        interrupt: Arc::default(),
        observer: Arc::new(()),
    }
}

pub fn bits(path: &Path) -> Vec<(String, Vec<u32>)> {
    let file = TensorFile::read(path).unwrap();
    let of = |data: &burn::tensor::TensorData| data.iter::<f32>().map(f32::to_bits).collect();
    file.tensors.iter().map(|(name, data)| (name.clone(), of(data))).collect()
}

pub fn losses(run: &Path) -> Vec<f64> {
    let events = Journal::read(&run.join("metrics.jsonl")).unwrap();
    let of = |event: &Event| match event {
        Event::Step(record) => Some(record.loss),
        Event::Validation(_) => None,
    };
    events.iter().filter_map(of).collect()
}

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

/// What a kill leaves at each point between the first validation and the first checkpoint, and around later ones: the best
/// weights stay, and the journal has every validation once.
#[test]
fn the_best_weights_survive_a_kill_at_any_point() {
    let folder = tempfile::tempdir().unwrap();
    let trained = options(folder.path(), "trained");
    train(&config(&["train.steps=20"]), &trained).unwrap();
    // Fine-tuning that only makes the weights worse.
    let spoil = config(&[
        "train.steps=8",
        "train.learning_rate=0.3",
        "train.warmup_steps=1",
        "train.validate_every=4",
    ]);
    let tune = |name: &str| TrainOptions {
        init: Some(trained.out.join("best.safetensors")),
        ..options(folder.path(), name)
    };
    let whole = tune("whole");
    let outcome = train(&spoil, &whole).unwrap();
    let scores: Vec<f64> = outcome.validations.iter().map(|v| v.score()).collect();
    assert!(scores[1] < scores[0] && scores[2] < scores[0], "{scores:?}");
    let best = bits(&whole.out.join("best.safetensors"));

    let remove = |run: &Path, names: &[&str]| {
        for name in names.iter().map(|name| run.join(name)) {
            if name.is_dir() { std::fs::remove_dir_all(name) } else { std::fs::remove_file(name) }.unwrap();
        }
    };
    type Kill<'a> = &'a dyn Fn(&Path);
    let cases: [(&str, u64, Kill<'_>); 4] = [
        ("after the best weights", 0, &|run| remove(run, &["last.safetensors", "state-0", "metrics.jsonl"])),
        ("after the journal's line", 0, &|run| remove(run, &["last.safetensors", "state-0"])),
        ("between the state's folder and its weights", 0, &|run| remove(run, &["last.safetensors"])),
        ("some steps later", 3, &|run| remove(run, &["last.safetensors", "state-3"])),
    ];
    for (index, (point, stop_at, kill)) in cases.into_iter().enumerate() {
        let mut options = tune(&format!("killed-{index}"));
        options.stop_at = Some(stop_at);
        train(&spoil, &options).unwrap();
        kill(&options.out);
        options.stop_at = None;
        let outcome = train(&spoil, &options).unwrap();
        assert_eq!(bits(&options.out.join("best.safetensors")), best, "killed {point}");
        let last = bits(&options.out.join("last.safetensors"));
        assert!(last == bits(&whole.out.join("last.safetensors")), "killed {point}");
        let steps: Vec<u64> = outcome.validations.iter().map(|v| v.step).collect();
        assert_eq!(steps, [0, 4, 8], "killed {point}");
    }

    // The state says that step 4 is validated, its best weights are gone: they are made again, not left out.
    let mut options = tune("without-best");
    options.stop_at = Some(0);
    train(&spoil, &options).unwrap();
    remove(&options.out, &["best.safetensors"]);
    train(&spoil, &options).unwrap();
    assert_eq!(bits(&options.out.join("best.safetensors")), best);
}

/// Between later best weights and the state: the file is that of a step that the state does not know yet.
#[test]
fn best_weights_of_a_lost_step_are_kept_unless_beaten() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=12", "train.validate_every=6", "train.ema_decay=0"]);
    let mut whole = options(folder.path(), "whole");
    whole.stop_at = Some(4);
    train(&config, &whole).unwrap();
    let copy = |name: &str, file: &str| {
        let to = folder.path().join(name);
        std::fs::create_dir_all(&to).unwrap();
        let files = std::fs::read_dir(whole.out.join(file)).unwrap();
        files.map(|file| file.unwrap()).filter(|file| file.path().is_file()).for_each(|file| {
            std::fs::copy(file.path(), to.join(file.file_name())).unwrap();
        });
    };
    copy("killed", "");
    copy("killed/state-4", "state-4");
    whole.stop_at = None;
    train(&config, &whole).unwrap();
    // The best weights of step 6 or 12 beside the state and the journal of step 4.
    let best = whole.out.join("best.safetensors");
    let killed = options(folder.path(), "killed");
    std::fs::copy(&best, killed.out.join("best.safetensors")).unwrap();
    // It goes on differently and learns nothing.
    let idle = self::config(&[
        "train.steps=12",
        "train.validate_every=6",
        "train.ema_decay=0",
        "train.learning_rate=1e-12",
    ]);
    train(&idle, &killed).unwrap();
    assert_eq!(bits(&killed.out.join("best.safetensors")), bits(&best));
    assert_ne!(bits(&killed.out.join("last.safetensors")), bits(&whole.out.join("last.safetensors")));
}

/// Asks to stop at the beginning of a validation, or when data are being made.
struct StopAt(Phase, Arc<Interrupt>);

impl TrainObserver for StopAt {
    fn begin(&self, phase: Phase, _: PhaseExtent) {
        if phase == self.0 {
            self.1.request();
        }
    }
}

#[test]
fn an_interrupt_ends_data_generation_and_validation_and_nothing_is_different_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=4", "train.validate_every=2", "train.warmup_steps=1"]);
    let whole = options(folder.path(), "whole");
    train(&config, &whole).unwrap();
    let stop = |folder: &Path, name: &str, phase: Phase, stop_at: Option<u64>| {
        let interrupt = Arc::new(Interrupt::default());
        let observer = Arc::new(StopAt(phase, interrupt.clone()));
        let options = TrainOptions { interrupt, observer, stop_at, ..options(folder, name) };
        train(&config, &options).unwrap()
    };
    // During the first validation; then, with that one done by another call, during the one of step 2.
    let outcome = stop(folder.path(), "parts", Phase::Validation, None);
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Interrupted, 0));
    assert!(outcome.validations.is_empty());
    let mut parts = options(folder.path(), "parts");
    parts.stop_at = Some(1);
    assert_eq!(train(&config, &parts).unwrap().validations.len(), 1);
    let outcome = stop(folder.path(), "parts", Phase::Validation, None);
    assert_eq!((outcome.step, outcome.validations.len()), (2, 1));
    parts.stop_at = None;
    let outcome = train(&config, &parts).unwrap();
    assert_eq!(outcome.validations.iter().map(|v| v.step).collect::<Vec<_>>(), [0, 2, 4]);
    for file in ["last.safetensors", "best.safetensors"] {
        assert_eq!(bits(&parts.out.join(file)), bits(&whole.out.join(file)), "{file}");
    }

    let other = tempfile::tempdir().unwrap();
    let outcome = stop(other.path(), "run", Phase::TrainingImages, None);
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Interrupted, 0));
    assert!(!other.path().join("data/smoke/val").exists());
    // Time that is up ends it as well.
    let mut late = options(other.path(), "run");
    late.time_limit = Some(Duration::from_millis(1));
    assert_eq!(train(&config, &late).unwrap().stop_reason, StopReason::TimeUp);
    assert!(!other.path().join("data/smoke/val").exists() && !late.out.join("last.safetensors").exists());
}

#[test]
fn a_run_folder_in_use_is_refused_and_a_fresh_start_that_fails_deletes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=2", "train.warmup_steps=1"]);
    let options = options(folder.path(), "run");
    train(&config, &options).unwrap();
    let files = |run: &Path| -> BTreeMap<_, _> {
        let entries = std::fs::read_dir(run).unwrap().map(|e| e.unwrap().path());
        entries
            .filter(|path| path.is_file())
            .map(|path| (path.clone(), std::fs::read(path).unwrap()))
            .collect()
    };
    let before = files(&options.out);
    let fresh = TrainOptions {
        fresh: true,
        init: Some("absent.safetensors".into()),
        ..self::options(folder.path(), "run")
    };
    let error = train(&config, &fresh).unwrap_err().to_string();
    assert!(error.contains("absent.safetensors"), "{error}");
    assert!(files(&options.out) == before);

    let lock = FolderLock::exclusive(&options.out).unwrap();
    for options in [&options, &fresh] {
        let error = train(&config, options).unwrap_err().to_string();
        assert!(error.contains(&format!("in use by process {} on ", std::process::id())), "{error}");
    }
    drop(lock);
    assert!(files(&options.out) == before);
}
