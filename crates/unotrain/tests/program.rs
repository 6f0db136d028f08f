//! `unotrain` as a process: killed, resumed, misused.

use std::{
    path::Path,
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use unopose_core::config::Config;
use unopose_nn::checkpoint::TensorFile;
use unopose_train::{Event, Journal};

fn unotrain(folder: &Path, out: &str, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unotrain"));
    command.args(["--config", "smoke", "--set", "train.steps=80", "--set", "train.checkpoint_seconds=0.2"]);
    command.arg("--data").arg(folder.join("data")).arg("--out").arg(folder.join(out)).args(more);
    command
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

fn weights(path: &Path) -> Vec<Vec<u32>> {
    let file = TensorFile::read(path).unwrap();
    file.tensors.values().map(|data| data.iter::<f32>().map(f32::to_bits).collect()).collect()
}

#[test]
fn a_killed_run_goes_on_from_its_checkpoint_and_ends_like_one_that_was_not() {
    let folder = tempfile::tempdir().unwrap();
    let run = |out: &str| unotrain(folder.path(), out, &[]).output().unwrap();
    let whole = run("whole");
    assert!(text(&whole).contains("finished: 80 steps"), "{}", text(&whole));

    let mut child = unotrain(folder.path(), "killed", &[]).spawn().unwrap();
    let last = folder.path().join("killed/last.safetensors");
    let begin = Instant::now();
    while !last.exists() && begin.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(300));
    child.kill().unwrap();
    child.wait().unwrap();
    let again = run("killed");
    assert!(text(&again).contains("finished: 80 steps"), "{}", text(&again));
    assert_eq!(weights(&last), weights(&folder.path().join("whole/last.safetensors")));
    let events = Journal::read(&folder.path().join("killed/metrics.jsonl")).unwrap();
    let steps: Vec<u64> = events.iter().filter(|e| matches!(e, Event::Step(_))).map(Event::step).collect();
    assert_eq!(steps, (1..=80).collect::<Vec<u64>>());

    let third = run("killed");
    assert!(
        third.status.success() && text(&third).contains("already finished: 80 steps"),
        "{}",
        text(&third)
    );
}

#[test]
fn the_printed_configuration_is_the_one_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let more = ["--set", "model.overlap=off", "--print-config"];
    let output = unotrain(folder.path(), "run", &more).output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
    let printed = folder.path().join("printed.toml");
    std::fs::write(&printed, &output.stdout).unwrap();
    let overrides = ["train.steps=80", "train.checkpoint_seconds=0.2", "model.overlap=off"].map(String::from);
    assert_eq!(Config::load(&printed, &[]).unwrap(), Config::embedded("smoke", &overrides).unwrap());
    assert!(!folder.path().join("run").exists() && !folder.path().join("data").exists());
}

#[test]
fn mistakes_are_named_and_exit_with_failure() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[&str], &str); 8] = [
        (&["--set", "trian.steps=3"], "--set trian.steps=3: unknown key `trian`, nearest valid: `train`"),
        (&["--set", "model.image_size=30"], "model.image_size is 30, expected a multiple of 4"),
        (&["--init", "absent.safetensors"], "cannot read checkpoint absent.safetensors: No such file"),
        (&["--set", "data.train=\"absent\""], "absent"),
        (&["--minutes", "NaN"], "invalid value 'NaN' for '--minutes <MINUTES>': expected a number above 0"),
        (&["--minutes=-1"], "expected a number above 0 and at most 5258880"),
        (&["--minutes", "1e300"], "expected a number above 0 and at most 5258880"),
        (&["--threads", "100000"], "100000 is not in 1..=1024"),
    ];
    for (arguments, expected) in cases {
        let output = unotrain(folder.path(), "run", arguments).output().unwrap();
        let text = text(&output);
        assert!(!output.status.success() && text.contains(expected), "{arguments:?}: {text}");
        assert!(!text.contains("panicked"), "{text}");
    }
}

/// A scheduler's signal in the middle of training: saved, an exit code of its own, and the rest is as if nothing had been.
#[cfg(unix)]
#[test]
fn a_terminated_run_saves_and_a_second_process_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let child = unotrain(folder.path(), "run", &["--set", "train.steps=1000000"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let last = folder.path().join("run/last.safetensors");
    let begin = Instant::now();
    while !last.exists() && begin.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(20));
    }
    let second = unotrain(folder.path(), "run", &["--fresh"]).output().unwrap();
    assert_eq!(second.status.code(), Some(1), "{}", text(&second));
    let owner = format!("in use by process {} on ", child.id());
    assert!(text(&second).contains(&owner), "{}", text(&second));
    let status = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(status.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(4), "{}", text(&output));
    assert!(text(&output).contains("of 1000000 steps, saved"), "{}", text(&output));
    let events = Journal::read(&folder.path().join("run/metrics.jsonl")).unwrap();
    let saved = TensorFile::read(&last).unwrap();
    let step: u64 = saved.metadata["step"].parse().unwrap();
    assert_eq!(events.iter().map(Event::step).max(), Some(step));
    let parts = std::fs::read_dir(folder.path().join("run")).unwrap();
    let names: Vec<_> = parts.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert!(names.iter().all(|name| !name.starts_with('.')), "{names:?}");
}
