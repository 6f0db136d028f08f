//! Runs that are killed, interrupted or in each other's way: nothing is lost, and nothing is different afterwards.

use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

use unopose_core::{folder_lock::FolderLock, interrupt::Interrupt};
use unopose_train::{Phase, PhaseExtent, StopReason, TrainObserver, TrainOptions, train};

use super::small_runs::{bits, config, options};

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
