//! Lists of single pairs of views: poses with given and with found masks, encoders alone.

use std::process::{Command, Output};

use serde_json::{Value, json};
use unopose_dataset::formats::{
    camera::CameraRecord,
    files::{read_json, write_json},
    image_io::{write_depth, write_mask, write_rgb},
};
use unopose_tests::ellipsoid_views::{spheroid, spheroid_pose};

use super::{absence::scored, infer::Files};

/// A list beside `files` with one pair: a printed spheroid before and after a turn of 20 degrees about its axis.
fn list(files: &Files) -> String {
    for (name, degrees) in [("reference", 0.0), ("query", 20.0)] {
        let (frame, mask) = spheroid(degrees, true);
        write_rgb(&files.at(&format!("{name}/rgb.png")), &frame.rgb).unwrap();
        write_depth(&files.at(&format!("{name}/depth.png")), &frame.depth, 0.1).unwrap();
        write_mask(&files.at(&format!("{name}/mask_egg.png")), &mask).unwrap();
        let camera = CameraRecord::new(&frame.intrinsics, 0.1);
        write_json(&files.at(&format!("{name}/camera.json")), &camera, true).unwrap();
    }
    let truth = spheroid_pose(20.0) * spheroid_pose(0.0).inverse();
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
    assert_eq!(given["verdict"], "print_wrong", "{given}");
    let absent = pair(0.95, "unoseg");
    assert_eq!(absent["verdict"], "no_pose");
    assert!(absent["error"].as_str().unwrap().contains("query, none is like the reference"), "{absent}");
    let found = pair(0.02, "unoseg");
    assert!((found["rotation_deg"].as_f64().unwrap() - 20.0).abs() < 1e-6, "{found}");
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
    assert!(areas.len() == 2 && areas.iter().all(|&area| area > 0.8), "{areas:?}");
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
