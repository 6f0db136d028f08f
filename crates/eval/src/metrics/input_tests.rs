//! Input that is in another unit, of other images, or not there: each is told with what gave it away.

use std::path::Path;

use unopose_core::files::write_atomic;
use unopose_dataset::{
    formats::{PoseResult, files::read_json},
    mesh::ply,
};

use super::{
    Evaluation, InputReport,
    tests::{DIAMETER, result, score, square, write_dataset},
};

/// One right pose for every image.
fn results() -> [PoseResult; 2] {
    [result(0, 0.15, 0.9, 0.5), result(1, 0.0, 0.8, 0.5)]
}

fn input(root: &Path, results: &[PoseResult]) -> InputReport {
    score(root, results).unwrap().scores.input
}

/// The results with translations in metres where millimetres are expected.
fn in_metres(results: [PoseResult; 2]) -> [PoseResult; 2] {
    results.map(|mut result| {
        result.t_camera_object.translation /= 1000.0;
        result
    })
}

/// The annotation of scene 1 with translations in metres.
fn annotate_in_metres(root: &Path) {
    let path = root.join("test/000001/scene_gt.json");
    let mut images: serde_json::Value = read_json(&path).unwrap();
    for instance in
        images.as_object_mut().unwrap().values_mut().flat_map(|image| image.as_array_mut().unwrap())
    {
        for number in instance["cam_t_m2c"].as_array_mut().unwrap() {
            *number = (number.as_f64().unwrap() / 1000.0).into();
        }
    }
    std::fs::write(&path, images.to_string()).unwrap();
}

#[test]
fn metres_for_millimetres_are_given_away_by_medians_and_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    assert_eq!(input(root, &results()), InputReport::default());
    let table = "median distance of the table's poses is 1.0, of the annotations 1011 (mm): are the table's translations in \
                 metres?";
    let evaluation = score(root, &in_metres(results())).unwrap();
    // Of 1.011 and 1 m.
    assert_eq!(evaluation.scores.input.warnings, [table]);
    evaluation.write(&root.join("out")).unwrap();
    let written: serde_json::Value = read_json(&root.join("out/scores.json")).unwrap();
    assert_eq!(written["warnings"][0], table);

    // Models.
    let info = root.join("models_eval/models_info.json");
    let millimetres = std::fs::read_to_string(&info).unwrap();
    std::fs::write(&info, format!(r#"{{"1": {{"diameter": {DIAMETER}}}}}"#)).unwrap();
    let warnings = input(root, &results()).warnings;
    assert!(
        warnings[0].ends_with(
            "models_info.json: object 1: diameter is 0.283 mm; models are expected in millimetres"
        )
    );
    assert_eq!(warnings[1], "model of object 1: diameter is 283 mm, models_info.json says 0.283 mm");
    let model = root.join("models_eval/obj_000001.ply");
    write_atomic(&model, |out| ply::write(&square(), 1.0, None, out)).unwrap();
    assert_eq!(input(root, &results()).warnings.len(), 1);
    std::fs::write(&info, millimetres).unwrap();
    let warnings = input(root, &results()).warnings;
    assert_eq!(warnings, ["model of object 1: diameter is 0.283 mm, models_info.json says 283 mm"]);
    write_atomic(&model, |out| ply::write(&square(), 1000.0, None, out)).unwrap();

    // Annotations, with a right table and with one that is wrong in the same way.
    annotate_in_metres(root);
    let truth = "median distance of the annotations is 1.0 (mm): are cam_t_m2c in metres?";
    assert_eq!(input(root, &results()).warnings, [truth]);
    let warnings = input(root, &in_metres(results())).warnings;
    assert_eq!(warnings[0], truth);
    assert_eq!(
        warnings[1],
        "median distance of the table's poses is 1.0 (mm): are the table's translations in metres?"
    );
}

#[test]
fn a_table_of_other_images_is_an_error_and_strangers_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    let shifted = results().map(|r| PoseResult { obj_id: 2, ..r });
    let message = score(root, &shifted).unwrap_err().to_string();
    for part in [
        "any name.csv: 2 of 2 results match no target (object ids in the file: 2, in the targets: 1)",
        "the object ids of the file look too large by 1: 2 would match then",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let message = score(root, &[]).unwrap_err().to_string();
    assert!(
        message.ends_with("any name.csv: result table is without a pose, expected at least one line"),
        "{message}"
    );
    // One of three is a stranger: counted, but nothing suspicious.
    let [a, b] = results();
    let scores = score(root, &[a, b, PoseResult { obj_id: 9, ..a }]).unwrap().scores;
    assert_eq!((scores.n_strangers, scores.input), (1, InputReport::default()));
}

#[test]
fn an_image_that_cannot_be_read_costs_its_own_targets() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    let whole = score(root, &results()).unwrap();
    assert!((whole.scores.recall.ar_mssd - 2.0 / 3.0).abs() < 1e-12);
    // The camera of image 1 is absurd.
    let cameras = root.join("test/000001/scene_camera.json");
    let mut value: serde_json::Value = read_json(&cameras).unwrap();
    value["1"]["cam_K"][0] = (-1.0).into();
    std::fs::write(&cameras, value.to_string()).unwrap();
    let Evaluation { scores, targets } = score(root, &results()).unwrap();
    assert_eq!((scores.recall.n_targets, scores.n_estimates, targets.len()), (3, 1, 3));
    assert!((scores.recall.ar_mssd - 1.0 / 3.0).abs() < 1e-12);
    assert_eq!(targets[..2], whole.targets[..2]);
    assert!(targets[2].errors.is_none() && targets[2].im_id == 1);
    assert!(scores.input.unread_images["scene 1 image 1"].contains("focal length fx is -1"));
    let warning = &scores.input.warnings[0];
    assert!(
        warning.starts_with("1 images cannot be read: unusable intrinsics (scene 1 image 1: "),
        "{warning}"
    );
    // Neither has image 0 a depth.
    std::fs::remove_file(root.join("test/000001/depth/000000.png")).unwrap();
    let message = score(root, &results()).unwrap_err().to_string();
    assert!(
        message.starts_with("none of 2 images can be scored: 1 images cannot be read: depth not found"),
        "{message}"
    );
}
