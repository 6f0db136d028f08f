//! Without a query mask: which instances there are, whether there is any, and which pose is the one to take.

use unopose_dataset::formats::files::read_json;
use unopose_infer::{Calibration, Feature, PoseCriterion, Term};
use unopose_nn::checkpoint;
use unopose_segment::{MatchFeature, MatchScore};

use super::infer::Files;

/// The files with a checkpoint whose masks score by their size alone, and whose poses are trusted by their number of points.
pub fn scored(threshold: f64) -> Files {
    let files = Files::new();
    let score = MatchScore {
        intercept: 2.0,
        weights: vec![(MatchFeature::Size, 1.0)],
        threshold,
        proposals: 100,
        searches: [20, 20],
        data: "made".into(),
    };
    let calibration = Calibration {
        intercept: -6.0,
        terms: vec![Term { feature: Feature::Points, weight: 1.0, usual: 5.0, typical: 7.0 }],
        threshold: 0.5,
        right: PoseCriterion::DEFAULT,
        pairs: 100,
        right_share: 0.5,
        data: "made".into(),
    };
    let (weights, output) = (files.at("weights.safetensors"), files.at("scored.safetensors"));
    checkpoint::annotate(&weights, &output, [score.to_metadata(), calibration.to_metadata()]).unwrap();
    files
}

const WITHOUT_MASK: [(&str, &str); 2] = [("--query-mask", ""), ("--checkpoint", "scored.safetensors")];

#[test]
fn an_object_below_the_fitted_threshold_is_not_there() {
    let files = scored(0.95);
    let output = files.estimate(&WITHOUT_MASK, &[]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(
        text.contains("none is like the reference") && text.contains("an instance at least 0.95"),
        "{text}"
    );
    assert!(!files.at("out/pose.json").exists() && !files.at("out/mask_0.png").exists());
    // A score that was not fitted says nothing about absence: the best mask is taken.
    let output = files.estimate(&[("--query-mask", "")], &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_pose_on_top_is_the_one_to_be_trusted_most() {
    let files = scored(0.02);
    let output = files.estimate(&WITHOUT_MASK, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let value: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    let instances = value["instances"].as_array().unwrap();
    assert!(instances.len() >= 2, "{} instances", instances.len());
    let trust = |instance: &serde_json::Value| {
        instance["confidence"].as_f64().unwrap() * instance["mask_score"].as_f64().unwrap()
    };
    let best = instances.iter().max_by(|a, b| trust(a).total_cmp(&trust(b))).unwrap();
    assert_eq!(value["T_query_reference"], best["T_query_reference"]);
    assert!(instances.iter().all(|i| i["mask_score"].as_f64().unwrap() >= 0.02));
}
