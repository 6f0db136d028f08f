//! Lists that are built, read or refused, and rendered references.

use unopose_dataset::{
    formats::{DatasetSplits, ReferenceTarget, Target, targets::write_targets},
    protocol::{Protocol, TargetFiles, TargetList},
};

use super::{super::*, write_dataset};

#[test]
fn lists_are_built_and_references_rendered() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path());
    let (root, out) = (folder.path().join("ycbv"), folder.path().join("out"));
    let target = |im_id| Target { scene_id: 1, im_id, obj_id: 1, inst_count: 1 };
    write_targets(&root.join("test_targets_bop19.json"), &[target(1), target(2)]).unwrap();
    let request = ListRequest {
        splits: DatasetSplits { dataset: root.clone(), ..DatasetSplits::default() },
        targets: None,
        detections: DetectionSource::GroundTruth,
        limit: None,
        seed: 5,
        rendered: true,
    };
    let lists = request.prepare(&[Protocol::Rot50], &out).unwrap();
    let PreparedList { facts, list } = &lists[0];
    assert_eq!((facts.list.as_str(), facts.list_seed, facts.without_reference), ("rendered", Some(5), 0));
    // The only image without targets is the reference of both, seen from the same side.
    let references: Vec<_> = list.targets.iter().map(|t| (t.im_id, t.ref_im_id, t.rot_deg)).collect();
    assert_eq!(references, [(1, 0, Some(0.0)), (2, 0, Some(0.0))]);
    assert_eq!(list.targets[0].overlap, Some(1.0));
    assert_eq!((list.detections.len(), list.detections[1].image_id), (2, 2));
    assert!(out.join("test_ref_targets_rot50.json").is_file());
    // The square of 20 cm at 1 m: 20 x 20 pixels around the middle, lit.
    let rendered = list.reference_split();
    assert_eq!(rendered.name(), "rendered");
    let scene = rendered.scene(1).unwrap();
    let (frame, mask) = (scene.frame(0).unwrap(), scene.mask_visib(0, 0).unwrap());
    assert_eq!(mask.count(), 400);
    assert_eq!((frame.depth.get(22, 41), frame.depth.get(21, 30)), (1.0, 0.0));
    assert!(frame.rgb.get_pixel(30, 30).0.iter().all(|&c| c > 40), "{:?}", frame.rgb.get_pixel(30, 30));
    // Nothing is from another scene.
    let message = request.prepare(&[Protocol::CrossScene], &out).unwrap_err().to_string();
    assert!(
        message.contains("none of 2 targets has a reference view for the list crossscene_rot50"),
        "{message}"
    );
    // A list is read as it is, given masks are scored.
    let request = ListRequest {
        targets: Some(root.join("targets.json")),
        detections: DetectionSource::File(root.join("dets.json")),
        rendered: false,
        ..request
    };
    let PreparedList { facts, list } = &request.prepare(&[Protocol::Rot50], &out).unwrap()[0];
    assert_eq!(
        (facts.list.as_str(), facts.segmentation.as_str(), facts.list_seed),
        ("targets", "dets", None)
    );
    assert_eq!((list.targets.len(), list.detections.len(), list.skipped.len()), (2, 1, 1));
    assert!((facts.mask_map.unwrap() - 51.0 / 101.0).abs() < 1e-12);
}

#[test]
fn lists_that_name_what_is_not_there_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_dataset(folder.path());
    let root = folder.path().join("ycbv");
    let good = list.targets[0].clone();
    for (bad, part) in [
        (ReferenceTarget { scene_id: 4, ..good.clone() }, "entry 1: scene_id is 4, expected a scene of"),
        (ReferenceTarget { im_id: 9, ..good.clone() }, "entry 1: im_id is 9, expected an image of"),
        (
            ReferenceTarget { obj_id: 7, ..good.clone() },
            "entry 1: obj_id is 7, expected an object annotated in",
        ),
        (ReferenceTarget { ref_scene_id: 4, ..good.clone() }, "ref_scene_id is 4"),
        (ReferenceTarget { ref_im_id: 9, ..good.clone() }, "ref_im_id is 9"),
        (good.clone(), "entry 1: entry is a repetition"),
    ] {
        write_targets(&root.join("bad.json"), &[good.clone(), bad]).unwrap();
        let files = TargetFiles {
            splits: DatasetSplits { dataset: root.clone(), ..DatasetSplits::default() },
            targets: root.join("bad.json"),
            detections: root.join("dets.json"),
            limit: None,
        };
        let message = TargetList::open(&files).unwrap_err().to_string();
        assert!(message.contains("bad.json") && message.contains(part), "{message}");
    }
}
