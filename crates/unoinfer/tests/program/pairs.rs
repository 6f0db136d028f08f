//! Lists of single pairs of views: poses with given and with found masks, encoders alone.

use std::process::{Command, Output};

use serde_json::{Value, json};
use unopose_dataset::formats::files::{read_json, write_json};
use unopose_tests::ellipsoid_views::EllipsoidViews;

use super::{absence::scored, infer::Files};

/// The two views of `files` as folders of a list, with one pair of the first object.
fn list(files: &Files) -> String {
    for name in ["query", "reference"] {
        for (from, to) in
            [("rgb/a.png", "rgb.png"), ("depth/a.png", "depth.png"), ("mask/a_0.png", "mask_egg.png")]
        {
            std::fs::copy(files.at(&format!("{name}/{from}")), files.at(&format!("{name}/{to}"))).unwrap();
        }
        std::fs::copy(files.at("camera.json"), files.at(&format!("{name}/camera.json"))).unwrap();
    }
    let views = EllipsoidViews::new(2, 5);
    let truth = views.pose(0, 0) * views.pose(1, 0).inverse();
    let pose = json!({ "R": truth.rotation_row_major(), "t": truth.translation.as_slice() });
    let pairs =
        json!([{ "object": "egg", "reference": "reference", "query": "query", "T_query_reference": pose }]);
    write_json(&files.at("pairs.json"), &pairs, true).unwrap();
    files.at("pairs.json").display().to_string()
}

fn run(files: &Files, command: &[&str], list: &str, more: &[&str]) -> Output {
    let checkpoint = files.at("scored.safetensors").display().to_string();
    let out = files.at("pairs").display().to_string();
    let given = ["--list", list, "--checkpoint", &checkpoint, "--out", &out];
    let arguments = command.iter().chain(&given).chain(more);
    Command::new(env!("CARGO_BIN_EXE_unoinfer")).args(arguments).output().unwrap()
}

#[test]
fn a_mask_that_is_not_found_gives_no_pose() {
    let pair = |threshold: f64, masks: &str| -> Value {
        let files = scored(threshold);
        let list = list(&files);
        let more = ["--methods", "aligncenter", "--detections", masks];
        let output = run(&files, &["bench", "pairs"], &list, &more);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(files.at("pairs/aligncenter.png").is_file());
        let runs: Value = read_json(&files.at("pairs/pairs.json")).unwrap();
        runs[0]["pairs"][0].clone()
    };
    let given = pair(0.95, "gt");
    assert!(given["translation"].as_f64().unwrap() < 0.3 && given["error"].is_null(), "{given}");
    let absent = pair(0.95, "unoseg");
    assert_eq!(absent["verdict"], "no_pose");
    assert!(absent["error"].as_str().unwrap().contains("query, none is like the reference"), "{absent}");
    let found = pair(0.02, "unoseg");
    assert!(found["error"].is_null() && found["rotation_deg"].is_number(), "{found}");
    assert_ne!(found["translation"], given["translation"]);
}

#[test]
fn encoders_are_measured_alone() {
    let files = scored(0.5);
    let list = list(&files);
    let output = run(&files, &["features"], &list, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let measured: Value = read_json(&files.at("pairs/features.json")).unwrap();
    let areas: Vec<f64> =
        measured[0]["areas"].as_array().unwrap().iter().map(|a| a.as_f64().unwrap()).collect();
    assert!(areas.len() == 2 && areas.iter().all(|area| (0.3..=1.0).contains(area)), "{areas:?}");
    let refused = |command: &[&str], more: &[&str], part: &str| {
        let output = run(&files, command, &list, more);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && text.contains(part), "{text}");
    };
    let weights = files.at("weights.safetensors").display().to_string();
    refused(&["features"], &["--teacher", &weights], "holds no DINOv2 backbone");
    refused(&["bench", "pairs"], &["--detections", &list], "expected gt or unoseg");
    refused(&["bench", "pairs"], &["--detections", "unoseg", "--proposals", "embedded,a.json"], "2 sources");
}
