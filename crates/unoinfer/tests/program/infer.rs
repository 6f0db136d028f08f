//! The `unoinfer` binary from the outside: what it writes, and what it says about bad input.

use std::{
    path::PathBuf,
    process::{Command, Output},
};

use unopose_core::{config::Config, frame::Mask, geometry::Pose};
use unopose_dataset::formats::{
    camera::CameraRecord,
    files::{read_json, write_json},
    image_io::{write_depth, write_mask, write_rgb},
};
use unopose_infer::{Calibration, Feature, PoseCriterion, Term};
use unopose_nn::{checkpoint, device::DeviceChoice, model::UnoPose};
use unopose_tests::ellipsoid_views::EllipsoidViews;

/// Two views as files, masks of both objects, a camera and an untrained checkpoint.
pub struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let views = EllipsoidViews::new(2, 5);
        let files = Self { folder };
        for (name, view) in ["query", "reference"].into_iter().zip(&views.frames) {
            write_rgb(&files.at(&format!("{name}/rgb/a.png")), &view.frame.rgb).unwrap();
            write_depth(&files.at(&format!("{name}/depth/a.png")), &view.frame.depth, 0.1).unwrap();
            for (object, instance) in view.instances.iter().enumerate() {
                write_mask(&files.at(&format!("{name}/mask/a_{object}.png")), &instance.mask_visib).unwrap();
            }
        }
        let camera = CameraRecord::new(&views.frames[0].frame.intrinsics, 0.1);
        write_json(&files.at("camera.json"), &camera, true).unwrap();
        let (device, _) = DeviceChoice::Auto.open().unwrap();
        let config = Config::embedded("smoke", &[]).unwrap();
        let model = UnoPose::new(&config.model, config.seed, &device);
        let meta = checkpoint::Meta::default();
        checkpoint::save(&files.at("weights.safetensors"), &model, &config, &meta).unwrap();
        files
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `estimate` with some files replaced.
    pub fn estimate(&self, replaced: &[(&str, &str)], more: &[&str]) -> Output {
        let mut files = vec![
            ("--query-rgb", "query/rgb/a.png"),
            ("--query-depth", "query/depth/a.png"),
            ("--query-mask", "query/mask/a_0.png"),
            ("--reference-rgb", "reference/rgb/a.png"),
            ("--reference-depth", "reference/depth/a.png"),
            ("--reference-mask", "reference/mask/a_0.png"),
            ("--camera", "camera.json"),
            ("--checkpoint", "weights.safetensors"),
            ("--out", "out"),
        ];
        for (flag, file) in replaced {
            match files.iter_mut().find(|(name, _)| name == flag) {
                Some(entry) => entry.1 = *file,
                None => files.push((*flag, *file)),
            }
        }
        let files = files.iter().filter(|(_, file)| !file.is_empty());
        let arguments =
            files.flat_map(|(flag, file)| [(*flag).to_owned(), self.at(file).display().to_string()]);
        run(["estimate".to_owned()].into_iter().chain(arguments).chain(more.iter().map(|s| (*s).to_owned())))
    }

    /// The message of a failed `estimate`, which must name `file` and `part`.
    pub fn refused(&self, replaced: &[(&str, &str)], file: &str, part: &str) {
        let output = self.estimate(replaced, &[]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains(file) && text.contains(part), "expected {file} and {part} in: {text}");
        assert!(!text.contains("panicked"), "{text}");
        assert!(!self.at("out").join("pose.json").exists());
    }
}

fn run(arguments: impl IntoIterator<Item = String>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unoinfer")).args(arguments).output().unwrap()
}

#[test]
fn a_kept_reference_replaces_its_images() {
    let files = Files::new();
    let kept = files.at("object.safetensors").display().to_string();
    let output = files.estimate(&[], &["--save-reference", &kept]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let first: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    let no_images = [("--reference-rgb", ""), ("--reference-depth", ""), ("--reference-mask", "")];
    let output = files.estimate(&no_images, &["--reference", &kept]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let second: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    for key in ["T_query_reference", "score"] {
        assert_eq!(first[key], second[key]);
    }
}

#[test]
fn estimate_writes_poses_and_overlays() {
    let files = Files::new();
    let second = files.at("query/mask/a_1.png").display().to_string();
    let output = files.estimate(&[], &["--query-mask", &second, "--seed", "4", "--refine", "icp"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let pose: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    let instances = pose["instances"].as_array().unwrap();
    assert_eq!(instances.len(), 2);
    let scores: Vec<f64> = instances.iter().map(|i| i["score"].as_f64().unwrap()).collect();
    assert_eq!(pose["score"].as_f64().unwrap(), scores[0].max(scores[1]));
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
    };
    let t = &pose["T_query_reference"];
    let r: [f64; 9] = numbers(&t["R"]).try_into().unwrap();
    let t: [f64; 3] = numbers(&t["t"]).try_into().unwrap();
    assert!(Pose::from_row_major(&r, &t).rotation_defect() < 1e-6);
    for key in ["overlap", "matched"] {
        assert!((0.0..=1.0).contains(&pose[key].as_f64().unwrap()), "{key}");
    }
    assert!(pose["timings"]["total"].as_f64().unwrap() > 0.0);
    let overlay = image::open(files.at("out/overlay.png")).unwrap().into_rgb8();
    let query = image::open(files.at("query/rgb/a.png")).unwrap().into_rgb8();
    assert_eq!(overlay.dimensions(), query.dimensions());
    assert_ne!(overlay, query);
}

#[test]
fn a_calibrated_checkpoint_tells_its_confidence() {
    let files = Files::new();
    let confidence_of = |name: &str, more: &[&str]| {
        let output = files.estimate(&[("--checkpoint", name)], more);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let pose: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
        (pose, String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (pose, line) = confidence_of("weights.safetensors", &[]);
    assert!(pose["confidence"].is_null() && pose["confident"].is_null(), "{pose}");
    assert!(line.contains("confidence unknown"), "{line}");

    // Without weights the probability is that of the intercept; the mask has fewer pixels than right poses have.
    let term = |feature, usual, typical| Term { feature, weight: 0.0, usual, typical };
    let calibration = Calibration {
        intercept: 0.0,
        terms: vec![term(Feature::Points, 1e6f64.ln(), 2e6f64.ln()), term(Feature::OverlapQuery, -2.0, -1.0)],
        threshold: 0.8,
        right: PoseCriterion::DEFAULT,
        pairs: 100,
        right_share: 0.5,
        data: "none".into(),
    };
    let (weights, calibrated) = (files.at("weights.safetensors"), files.at("calibrated.safetensors"));
    checkpoint::annotate(&weights, &calibrated, [calibration.to_metadata()]).unwrap();
    let (pose, line) = confidence_of("calibrated.safetensors", &[]);
    assert_eq!((pose["confidence"].as_f64(), pose["confident"].as_bool()), (Some(0.5), Some(false)));
    let reasons = pose["reasons"].as_array().unwrap();
    assert_eq!(reasons.len(), 1, "{pose}");
    assert_eq!(reasons[0]["kind"], "few_points");
    assert!(line.contains("not confident (0.50: few points"), "{line}");
    let (pose, line) = confidence_of("calibrated.safetensors", &["--min-confidence", "0.4"]);
    assert_eq!(pose["confident"].as_bool(), Some(true));
    assert!(pose["reasons"].as_array().unwrap().is_empty() && line.contains("confidence 0.50"), "{line}");
}

#[test]
fn a_folder_of_queries_is_a_batch() {
    let files = Files::new();
    let folder = files.at("query");
    let output = files.estimate(
        &[("--query-rgb", ""), ("--query-depth", ""), ("--query-mask", ""), ("--query-dir", "query")],
        &[],
    );
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let pose: serde_json::Value = read_json(&files.at("out/a/pose.json")).unwrap();
    assert_eq!(pose["instances"].as_array().unwrap().len(), 2);
    assert!(files.at("out/a/overlay.png").is_file());
    // A second view without depth stops the listing, before any work.
    std::fs::copy(folder.join("rgb/a.png"), folder.join("rgb/b.png")).unwrap();
    let replaced =
        [("--query-rgb", ""), ("--query-depth", ""), ("--query-mask", ""), ("--query-dir", "query")];
    files.refused(&replaced, "depth", "b.png");
}

#[test]
fn bad_files_are_named() {
    let files = Files::new();
    files.refused(&[("--query-rgb", "absent.png")], "absent.png", "No such file");
    files.refused(&[("--camera", "query/rgb/a.png")], "a.png", "UTF-8");

    let png = std::fs::read(files.at("query/depth/a.png")).unwrap();
    std::fs::write(files.at("half.png"), &png[..png.len() / 2]).unwrap();
    files.refused(&[("--query-depth", "half.png")], "half.png", "not a readable image");

    write_mask(&files.at("small.png"), &Mask { width: 32, height: 24, data: vec![true; 32 * 24] }).unwrap();
    files.refused(&[("--query-mask", "small.png")], "small.png", "mask size is 32 x 24, expected 320 x 240");
    files.refused(&[("--reference-mask", "small.png")], "small.png", "mask size is 32 x 24");
    write_mask(&files.at("empty.png"), &Mask::empty(320, 240)).unwrap();
    files.refused(&[("--query-mask", "empty.png")], "empty.png", "mask is empty");
    let mut few = Mask::empty(320, 240);
    few.data[120 * 320 + 100..][..3].fill(true);
    write_mask(&files.at("few.png"), &few).unwrap();
    files.refused(&[("--query-mask", "few.png")], "few.png", "pixels");
}

#[test]
fn bad_cameras_are_named() {
    let files = Files::new();
    let camera = |name: &str, fx: &str, scale: &str| {
        let text =
            format!(r#"{{"cam_K": [{fx}, 0, 159.5, 0, 300, 119.5, 0, 0, 1], "depth_scale": {scale}}}"#);
        std::fs::write(files.at(name), text).unwrap();
    };
    camera("zero.json", "0", "0.1");
    files.refused(&[("--camera", "zero.json")], "zero.json", "fx is 0");
    camera("nan.json", "NaN", "0.1");
    files.refused(&[("--camera", "nan.json")], "nan.json", "line 1");
    camera("no_scale.json", "300", "0");
    files.refused(&[("--camera", "no_scale.json")], "no_scale.json", "depth_scale is 0");
    // Without a unit a pose would be as far off as the guess.
    let without = |name: &str, more: &str| {
        let text = format!(r#"{{"cam_K": [300, 0, 159.5, 0, 300, 119.5, 0, 0, 1]{more}}}"#);
        std::fs::write(files.at(name), text).unwrap();
    };
    without("absent.json", "");
    files.refused(&[("--camera", "absent.json")], "absent.json", "depth_scale not found");
    without("misspelt.json", r#", "depthScale": 0.1"#);
    files.refused(&[("--camera", "misspelt.json")], "misspelt.json", "depthScale is unknown");
    without("other.json", r#", "depth_scale": 0.1, "width": 640, "height": 480"#);
    files.refused(&[("--camera", "other.json")], "other.json", "640 x 480, expected 320 x 240");
    // Units read as metres, and as thousandths of a millimetre.
    camera("metres.json", "300", "100");
    files.refused(
        &[("--reference-camera", "metres.json")],
        "metres.json",
        "depth_scale of 0.1 instead of 100",
    );
    camera("micro.json", "300", "0.005");
    files.refused(&[("--reference-camera", "micro.json")], "micro.json", "depth_scale of 0.1 instead");
    // The query in another unit than the reference.
    std::fs::copy(files.at("camera.json"), files.at("reference.json")).unwrap();
    let cameras = [("--camera", "metres.json"), ("--reference-camera", "reference.json")];
    files.refused(&cameras, "metres.json", "depth_scale of 0.1 instead of 100");
}

/// `doctor` on the same files as `estimate`: exit code and standard output.
fn doctor(files: &Files, camera: &str, query_mask: &str) -> (Option<i32>, String) {
    let path = |name: &str| files.at(name).display().to_string();
    let mut arguments = vec!["doctor".to_owned()];
    for (flag, file) in [
        ("--query-rgb", "query/rgb/a.png"),
        ("--query-depth", "query/depth/a.png"),
        ("--query-mask", query_mask),
        ("--reference-rgb", "reference/rgb/a.png"),
        ("--reference-depth", "reference/depth/a.png"),
        ("--reference-mask", "reference/mask/a_0.png"),
        ("--camera", camera),
        ("--out", "doctor"),
    ] {
        arguments.extend([flag.to_owned(), path(file)]);
    }
    let output = run(arguments);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("panicked"));
    (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn a_doubtful_unit_is_a_warning_and_an_impossible_one_is_wrong() {
    let files = Files::new();
    let camera = |name: &str, scale: &str| {
        let text = format!(r#"{{"cam_K": [300, 0, 159.5, 0, 300, 119.5, 0, 0, 1], "depth_scale": {scale}}}"#);
        std::fs::write(files.at(name), text).unwrap();
    };
    let units = |camera: &str| -> Vec<serde_json::Value> {
        let output = files.estimate(&[("--camera", camera)], &[]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let pose: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
        let warnings = pose["warnings"].as_array().unwrap();
        warnings.iter().filter(|warning| warning["check"] == "unit").cloned().collect()
    };
    assert!(units("camera.json").is_empty());
    camera("tenfold.json", "1");
    let tenfold = units("tenfold.json");
    assert_eq!(
        (tenfold.len(), &tenfold[0]["view"], &tenfold[0]["level"]),
        (2, &"reference".into(), &"look".into())
    );
    for warning in &tenfold {
        let advice = warning["advice"].as_str().unwrap();
        assert!(advice.contains("depth_scale of 0.1 instead of 1"), "{advice}");
        assert!(warning["values"]["distance_m"].as_f64().unwrap() > 4.0, "{warning}");
    }

    let (code, text) = doctor(&files, "camera.json", "query/mask/a_0.png");
    assert!(code == Some(0) && text.contains("is that right?"), "{text}");
    assert!(!text.contains("\n  wrong"), "{text}");
    assert!(image::open(files.at("doctor/doctor.png")).unwrap().width() > 1000);
    camera("metres.json", "100");
    let (code, text) = doctor(&files, "metres.json", "query/mask/a_0.png");
    assert!(code == Some(1) && text.contains("\n  wrong  unit"), "{text}");
    // What cannot be read is wrong as well, and the rest is still looked at.
    let (code, text) = doctor(&files, "camera.json", "query/rgb/absent.png");
    assert!(code == Some(1) && text.contains("\n  wrong  images") && text.contains("absent.png"), "{text}");
    assert!(text.contains("reference: ") && text.contains("is that right?"), "{text}");
}

#[test]
fn bad_checkpoints_and_options_are_named() {
    let files = Files::new();
    std::fs::write(files.at("junk.safetensors"), b"not a checkpoint").unwrap();
    files.refused(&[("--checkpoint", "junk.safetensors")], "junk.safetensors", "not a safetensors file");
    let bytes = std::fs::read(files.at("weights.safetensors")).unwrap();
    std::fs::write(files.at("cut.safetensors"), &bytes[..bytes.len() - 100]).unwrap();
    files.refused(&[("--checkpoint", "cut.safetensors")], "cut.safetensors", "not a safetensors file");
    files.refused(&[("--checkpoint", "absent.safetensors")], "absent.safetensors", "cannot read");

    let output = files.estimate(&[], &["--refine", "magic"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && text.contains("expected none, icp or gicp"), "{text}");
    let output = files.estimate(&[], &["--device", "abacus"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && text.contains("[possible values: auto, flex"), "{text}");
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn the_official_toolkits_scores_come_out_of_the_command_line() {
    let dev = unopose_tests::shared("bench/dev");
    let out = tempfile::tempdir().unwrap();
    let table = dev.join("oracle/refaligncenter_dev-test.csv");
    let paths = [("--dataset", dev.as_path()), ("--results", &table), ("--out", out.path())];
    let arguments = paths.into_iter().flat_map(|(flag, path)| [flag.to_owned(), path.display().to_string()]);
    let output = run(["score".to_owned()].into_iter().chain(arguments));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let scores: serde_json::Value = read_json(&out.path().join("scores.json")).unwrap();
    for (key, expected) in
        [("AR", 0.348391), ("AR_VSD", 0.233842), ("AR_MSSD", 0.454433), ("AR_MSPD", 0.356897)]
    {
        let value = scores[key].as_f64().unwrap();
        assert!((value - expected).abs() < 1e-3, "{key} is {value}, the toolkit says {expected}");
    }
    assert_eq!(scores["n_targets"], 406);
}

#[test]
fn descriptors_and_templates_are_refused_where_they_have_no_use() {
    let files = Files::new();
    let root = files.folder.path().display().to_string();
    let weights = files.at("weights.safetensors").display().to_string();
    let dataset = ["--dataset", &root, "--targets", "targets.json"];
    let refused = |command: &str, more: &[&str], part: &str| {
        let arguments = std::iter::once(&command).chain(&dataset).chain(more);
        let output = run(arguments.map(|s| (*s).to_owned()));
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && text.contains(part), "expected {part} in: {text}");
    };
    refused("segment", &["--templates"], "--descriptor");
    let for_unoseg = "--descriptor, --proposals and --sam-points are for --detections unoseg";
    refused("eval", &["--descriptor", &weights, "--detections", "d.json"], for_unoseg);
    refused("eval", &["--proposals", "embedded", "--detections", "gt"], for_unoseg);
    refused("bench", &["--descriptor", &weights], for_unoseg);
    // A checkpoint of this program is no DINOv2.
    refused("segment", &["--descriptor", &weights, "--templates", "42"], "holds no DINOv2 backbone");
}
