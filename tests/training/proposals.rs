//! A small proposal network learns generated scenes, resumes bit for bit, and proposes masks.

use burn::tensor::Device;
use unopose_core::config::Config;
use unopose_segment::LearnedProposals;
use unopose_train::{StopReason, train_proposals};

use super::small_runs::{bits, losses, options};

fn config(overrides: &[&str]) -> Config {
    let small = [
        "synth.distractors=[0, 0]",
        "synth.objects_per_scene=[0, 3]",
        "proposals.width=64",
        "proposals.height=48",
        "proposals.channels=[4, 8, 8, 8]",
        "train.learning_rate=4e-3",
        "train.batch_size=3",
        "train.validation_pairs=3",
    ];
    let all: Vec<String> = small.iter().chain(overrides).map(|text| (*text).to_owned()).collect();
    Config::embedded("smoke", &all).unwrap()
}

#[test]
fn the_loss_falls_and_a_resumed_run_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&["train.steps=30"]);
    let whole = options(folder.path(), "whole");
    let outcome = train_proposals(&config, &whole).unwrap();
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Finished, 30));
    let steps = losses(&whole.out);
    let mean = |steps: &[f64]| steps.iter().sum::<f64>() / steps.len() as f64;
    assert!(mean(&steps[25..]) < 0.75 * mean(&steps[..5]), "{steps:?}");
    let recall = outcome.validations.last().unwrap().proposals.unwrap();
    assert!(recall.objects > 0 && recall.recall_75 <= recall.recall_50, "{recall:?}");
    for file in ["best.safetensors", "last.safetensors", "curves.svg", "proposals.png"] {
        assert!(whole.out.join(file).is_file(), "{file}");
    }

    let mut parts = options(folder.path(), "parts");
    parts.stop_at = Some(13);
    assert_eq!(train_proposals(&config, &parts).unwrap().stop_reason, StopReason::Interrupted);
    parts.stop_at = None;
    assert_eq!(train_proposals(&config, &parts).unwrap().stop_reason, StopReason::Finished);
    assert_eq!(bits(&parts.out.join("last.safetensors")), bits(&whole.out.join("last.safetensors")));
    assert_eq!(losses(&parts.out), steps);

    LearnedProposals::load(&whole.out.join("best.safetensors"), &Device::flex()).unwrap();
}

#[test]
fn what_cannot_be_trained_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for (set, part) in [
        (r#"train.precision="bf16""#, "train.precision is bf16, expected f32"),
        ("synth.distractors=[0, 2]", "synth.distractors is [0, 2], expected [0, 0]"),
    ] {
        let error = train_proposals(&config(&[set]), &options(folder.path(), "run")).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    let wrong = Config::embedded("smoke", &["proposals.width=40".to_owned()]).unwrap_err().to_string();
    assert!(wrong.contains("proposals.width is 40, expected a multiple of 16"), "{wrong}");
    assert!(!folder.path().join("run").exists());
}
