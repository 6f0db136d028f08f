//! Lists of images alone, and images whose poses are kept secret.

use std::path::Path;

use unopose_dataset::formats::{
    BopSplit, PoseResult, Target, detections::visible_instances, targets::read_annotated_targets,
};

use super::{
    EvalError, RegionKind, coco_scores,
    tests::{result, score, write_dataset},
};

/// Two right poses of image 0, of three instances, and a wrong one of image 1.
fn results() -> [PoseResult; 3] {
    [result(0, 0.15, 0.9, 0.5), result(0, -0.15, 0.8, 0.5), result(1, 0.5, 0.7, 0.5)]
}

fn write(root: &Path, name: &str, text: &str) {
    std::fs::write(root.join(name), text).unwrap();
}

#[test]
fn a_list_of_images_counts_every_visible_instance() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    // Image 0 has three instances, all visible; the list with objects asks for two of them.
    let of_objects = score(root, &results()).unwrap();
    assert_eq!(of_objects.scores.recall.n_targets, 3);
    std::fs::remove_file(root.join("test_targets_bop19.json")).unwrap();
    write(root, "test_targets_bop24.json", r#"[{"scene_id": 1, "im_id": 0}, {"scene_id": 1, "im_id": 1}]"#);
    let of_images = score(root, &results()).unwrap();
    let indices: Vec<_> = of_images.targets.iter().map(|t| (t.im_id, t.gt_index)).collect();
    assert_eq!(indices.len(), 4, "{indices:?}");
    // Two of four are found at every threshold.
    assert!((of_images.scores.recall.ar_mssd - 0.5).abs() < 1e-12);
    // 51 of the 101 recalls are reached with precision 1.
    assert!((of_images.scores.detection.map_mssd - 51.0 / 101.0).abs() < 1e-12);
    // One image of the two: the wrong pose is of no target.
    write(root, "test_targets_bop24.json", r#"[{"scene_id": 1, "im_id": 0}]"#);
    let one = score(root, &results()).unwrap();
    assert_eq!((one.scores.recall.n_targets, one.scores.n_strangers), (3, 1));
    assert!((one.scores.recall.ar_mssd - 2.0 / 3.0).abs() < 1e-12);
}

#[test]
fn images_without_annotations_are_left_out_and_nothing_is_scored_without_any() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    let path = root.join("test/000001/scene_gt.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let whole = score(root, &results()).unwrap();
    // The wrong pose of image 1 no longer counts.
    std::fs::write(&path, text.replace("\"1\":", "\"11\":")).unwrap();
    let partly = score(root, &results()).unwrap();
    assert_eq!((whole.scores.recall.n_targets, partly.scores.recall.n_targets), (3, 2));
    assert!((whole.scores.recall.ar_mssd - 2.0 / 3.0).abs() < 1e-12);
    assert!((partly.scores.recall.ar_mssd - 1.0).abs() < 1e-12);
    std::fs::remove_file(&path).unwrap();
    let error = score(root, &results()).unwrap_err();
    assert!(matches!(error, EvalError::NoAnnotations { .. }));
    let message = error.to_string();
    assert!(
        message.contains("000001/scene_gt.json: no annotation") && message.contains("nothing to score"),
        "{message}"
    );
}

#[test]
fn an_image_whose_masks_are_missing_costs_detections_its_own_instances() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_dataset(root);
    let split = BopSplit::open(&root.join("test")).unwrap();
    let list = root.join("test_targets_bop19.json");
    let targets = read_annotated_targets(&list, &split).unwrap();
    let map = |targets: &[Target]| {
        let detections = visible_instances(&split, targets).unwrap();
        coco_scores(&split, targets, &detections, RegionKind::Mask).map(|s| (s.n_instances, s.n_detections))
    };
    assert_eq!(map(&targets).unwrap(), (4, 3));
    std::fs::remove_file(root.join("test/000001/mask_visib/000001_000000.png")).unwrap();
    assert_eq!(map(&targets).unwrap(), (3, 2));
    assert!(visible_instances(&split, &targets[1..]).unwrap_err().to_string().contains("000001_000000.png"));
    let only = coco_scores(&split, &targets[1..], &[], RegionKind::Mask).unwrap_err().to_string();
    assert!(only.contains("000001_000000.png"), "{only}");
    std::fs::remove_file(root.join("test/000001/scene_gt.json")).unwrap();
    let split = BopSplit::open(&root.join("test")).unwrap();
    let hidden = coco_scores(&split, &targets, &[], RegionKind::Mask).unwrap_err();
    assert!(matches!(hidden, EvalError::NoAnnotations { .. }), "{hidden}");
}
