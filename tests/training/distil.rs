//! A colour encoder learns a small random teacher, resumes bit for bit, and goes into a pose network.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use unopose_core::config::Config;
use unopose_nn::{
    checkpoint::{Meta, TensorFile, load_encoder, load_except_encoder, save},
    model::UnoPose,
};
use unopose_tests::backbone_files::{Sizes, meta, safetensors, weights};
use unopose_train::{Event, Journal, StopReason, TrainOptions, distil, train};

use super::small_runs::{bits, losses, options};

const ENCODER: &str =
    r#"model.color={kind="hybrid", channels=[4, 8], embed_dim=64, depth=1, heads=1, out_dim=8}"#;

fn config(overrides: &[&str]) -> Config {
    let small = [
        ENCODER,
        "distil.teacher_image_size=64",
        "distil.teacher_blocks=3",
        "distil.points=64",
        "train.learning_rate=4e-3",
    ];
    let all: Vec<String> = small.iter().chain(overrides).map(|text| (*text).to_owned()).collect();
    Config::embedded("smoke", &all).unwrap()
}

/// Four blocks, patches of 8 pixels, 8 x 8 of them.
fn teacher(folder: &Path) -> PathBuf {
    let path = folder.join("teacher.safetensors");
    let sizes = Sizes { width: 64, depth: 4, patch: 8, side: 8, registers: 0 };
    safetensors(&path, &meta(weights(sizes, 5)));
    path
}

#[test]
fn features_come_near_the_teachers_and_a_resumed_run_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let teacher = teacher(folder.path());
    let config = config(&["train.steps=40", "distil.contrast_weight=0.5"]);
    let whole = options(folder.path(), "whole");
    let outcome = distil(&config, &whole, &teacher).unwrap();
    assert_eq!((outcome.stop_reason, outcome.step), (StopReason::Finished, 40));
    let (first, last) = (&outcome.validations[0], outcome.validations.last().unwrap());
    assert!(last.loss < 0.8 * first.loss, "{} to {}", first.loss, last.loss);
    let area = last.roc_area.unwrap();
    assert!((0.3..1.0).contains(&area), "{area}");
    for file in ["best.safetensors", "last.safetensors", "curves.svg", "features.png"] {
        assert!(whole.out.join(file).is_file(), "{file}");
    }

    let mut parts = options(folder.path(), "parts");
    parts.stop_at = Some(17);
    assert_eq!(distil(&config, &parts, &teacher).unwrap().stop_reason, StopReason::Interrupted);
    parts.stop_at = None;
    assert_eq!(distil(&config, &parts, &teacher).unwrap().stop_reason, StopReason::Finished);
    assert_eq!(bits(&parts.out.join("last.safetensors")), bits(&whole.out.join("last.safetensors")));
    assert_eq!(losses(&parts.out), losses(&whole.out));

    // The encoder goes into a pose network, which trains from it.
    let best = whole.out.join("best.safetensors");
    let device = Device::default();
    let random = UnoPose::new(&config.model, 9, &device);
    let model = load_encoder(&best, &config.model, random).unwrap();
    let stored = TensorFile::read(&best).unwrap();
    let name = "feature_extraction.rgb_net.hybrid.pos_embed";
    let expected: Vec<f32> = stored.tensors[name].iter::<f32>().collect();
    let loaded = model.feature_extraction.rgb_net.hybrid.unwrap().pos_embed.val();
    assert_eq!(loaded.into_data().iter::<f32>().collect::<Vec<_>>(), expected);
    let with_weights = format!(
        r#"model.color={{kind="hybrid", channels=[4, 8], embed_dim=64, depth=1, heads=1, out_dim=8, weights={best:?}}}"#
    );
    let poses = self::config(&["train.steps=2", "train.warmup_steps=1", &with_weights]);
    let outcome = train(&poses, &options(folder.path(), "poses")).unwrap();
    assert_eq!(outcome.stop_reason, StopReason::Finished);
    // Features that are kept as they were, and features that are not.
    let last_term = |name: &str, weight: &str| {
        let set = [format!("loss.kept_structure_weight={weight}"), format!("loss.kept_encoder={best:?}")];
        let config =
            self::config(&["train.steps=12", "train.warmup_steps=1", &with_weights, &set[0], &set[1]]);
        let run = options(folder.path(), name);
        train(&config, &run).unwrap();
        let events = Journal::read(&run.out.join("metrics.jsonl")).unwrap();
        let steps: Vec<f64> = events
            .iter()
            .filter_map(|event| match event {
                Event::Step(record) => Some(record.terms["kept_structure"]),
                Event::Validation(_) => None,
            })
            .collect();
        assert!(steps[0] < 1e-10, "{}", steps[0]);
        steps[11]
    };
    let (loose, kept) = (last_term("loose", "1e-9"), last_term("kept", "1e4"));
    assert!(kept < 0.5 * loose, "kept {kept}, loose {loose}");
    // With another network's weights for everything else.
    let conv = Config::embedded("smoke", &[]).unwrap();
    let other = folder.path().join("other.safetensors");
    let of_other = UnoPose::new(&conv.model, 3, &device);
    save(&other, &of_other, &conv, &Meta::default()).unwrap();
    let mixed = load_except_encoder(&other, &poses.model, UnoPose::new(&poses.model, 9, &device)).unwrap();
    let weight = |model: &UnoPose| -> Vec<f32> {
        model.coarse_point_matching.in_proj.weight.val().into_data().iter::<f32>().collect()
    };
    assert_eq!(weight(&mixed), weight(&of_other));
    assert!(mixed.feature_extraction.rgb_net.hybrid.is_some());
    let with_init = TrainOptions { init: Some(other.clone()), ..options(folder.path(), "mixed") };
    assert_eq!(train(&poses, &with_init).unwrap().stop_reason, StopReason::Finished);
    // A network of another width is refused by the tensors that differ.
    let wide = with_weights.replace("embed_dim=64", "embed_dim=128");
    let error = train(&self::config(&[&wide]), &options(folder.path(), "wide")).unwrap_err().to_string();
    assert!(error.contains("best.safetensors") && error.contains("embed_dim"), "{error}");
}

#[test]
fn what_cannot_be_distilled_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = teacher(folder.path());
    for (overrides, part) in [
        (
            ["distil.teacher_image_size=72"],
            "distil.teacher_image_size is 72, expected a multiple of model.image_size = 32",
        ),
        (["distil.teacher_blocks=5"], "distil.teacher_blocks is 5, expected at most 4, the blocks of"),
        (["distil.points=97"], "distil.points is 97, expected at most model.fine_points = 96"),
        ([r#"model.color={kind="none", out_dim=8}"#], "model.color.kind is none, expected hybrid or conv"),
        ([r#"train.precision="bf16""#], "train.precision is bf16, expected f32"),
    ] {
        let error =
            distil(&config(&overrides), &options(folder.path(), "run"), &file).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    let keeping = Config::embedded("smoke", &["loss.kept_encoder=\"no.safetensors\"".to_owned()]).unwrap();
    let error = train(&keeping, &options(folder.path(), "keeping")).unwrap_err().to_string();
    assert!(error.contains("no.safetensors"), "{error}");
    let absent = folder.path().join("absent.pth");
    let error = distil(&config(&[]), &options(folder.path(), "run"), &absent).unwrap_err().to_string();
    assert!(error.contains("absent.pth"), "{error}");
    assert!(!folder.path().join("run").exists());
}
