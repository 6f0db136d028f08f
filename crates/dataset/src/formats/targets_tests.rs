//! Lists of targets, of images and of references.

use super::*;

#[test]
fn a_reference_list_is_a_target_list() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("targets.json");
    let entry = |ref_im_id, rot_deg| ReferenceTarget {
        scene_id: 2,
        im_id: 4,
        obj_id: 1,
        ref_scene_id: 101,
        ref_im_id,
        rot_deg,
        overlap: None,
    };
    let list = [entry(0, Some(12.5)), entry(1, None)];
    write_targets(&path, &list).unwrap();
    assert_eq!(read_reference_targets(&path).unwrap(), list);
    let expected = Target { scene_id: 2, im_id: 4, obj_id: 1, inst_count: 1 };
    assert_eq!(read_targets(&path).unwrap(), [expected]);
    let message = read_reference_targets(&folder.path().join("absent.json")).unwrap_err().to_string();
    assert!(message.contains("absent.json"), "{message}");
}

#[test]
fn useless_lists_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("targets.json");
    let zero = r#"[{"scene_id":1,"im_id":0,"obj_id":1,"inst_count":0}]"#;
    for (text, part) in [("[]", "empty"), (zero, "inst_count is 0"), (r#"[{"scene_id":1}]"#, "im_id")] {
        std::fs::write(&path, text).unwrap();
        let message = read_targets(&path).unwrap_err().to_string();
        assert!(message.contains("targets.json") && message.contains(part), "{message}");
    }
}

/// Object 3 in image 0, objects 3 and 4 in image 1, one of two instances of 4 hardly visible.
fn write_split(folder: &Path) -> BopSplit {
    let scene = folder.join("000005");
    std::fs::create_dir_all(&scene).unwrap();
    let camera = r#"{"cam_K": [9, 0, 1, 0, 9, 1, 0, 0, 1], "depth_scale": 1}"#;
    let cameras = format!(r#"{{"0": {camera}, "1": {camera}, "2": {camera}}}"#);
    let gt = |obj_id: u32| {
        format!(r#"{{"cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [0,0,9], "obj_id": {obj_id}}}"#)
    };
    let info = |visible: f64| format!(r#"{{"px_count_visib": 9, "visib_fract": {visible}}}"#);
    let file = |name: &str, text: String| std::fs::write(scene.join(name), text).unwrap();
    file("scene_camera.json", cameras);
    file("scene_gt.json", format!(r#"{{"0": [{}], "1": [{}, {}, {}]}}"#, gt(3), gt(3), gt(4), gt(4)));
    let infos = format!(r#"{{"0": [{}], "1": [{}, {}, {}]}}"#, info(1.0), info(0.3), info(0.05), info(0.1));
    file("scene_gt_info.json", infos);
    BopSplit::open(folder).unwrap()
}

#[test]
fn a_list_of_images_asks_for_all_that_is_visible_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let split = write_split(folder.path());
    let path = folder.path().join("test_targets_bop24.json");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        read_annotated_targets(&path, &split)
    };
    let target = |im_id, obj_id, inst_count| Target { scene_id: 5, im_id, obj_id, inst_count };
    let both = read(r#"[{"scene_id": 5, "im_id": 1.0}, {"scene_id": 5, "im_id": 0}]"#).unwrap();
    assert_eq!(both, [target(0, 3, 1), target(0, 4, 0), target(1, 3, 1), target(1, 4, 1)]);
    let one = read(r#"[{"scene_id": 5, "im_id": 0}, {"scene_id": 5, "im_id": 0}]"#).unwrap();
    assert_eq!(one, [target(0, 3, 1)]);
    // The same file where nothing says what is in the images, and for those who need objects.
    let message = read_targets(&path).unwrap_err().to_string();
    assert!(
        message.contains("bop24.json: obj_id not found") && message.contains("test_targets_bop19.json"),
        "{message}"
    );
    for (text, part) in [
        (r#"[{"scene_id": 5, "im_id": 2}]"#, "scene_gt.json has no annotation of them"),
        (r#"[{"scene_id": 5, "im_id": 3}]"#, "im_id is 3, expected an image of"),
        (r#"[{"scene_id": 6, "im_id": 0}]"#, "scene_id is 6, expected a scene of"),
        (
            r#"[{"scene_id": 5, "im_id": 0}, {"scene_id": 5, "im_id": 0, "obj_id": 3}]"#,
            "obj_id not found (entry 1 has one)",
        ),
        (
            r#"[{"scene_id": 5, "im_id": 0, "obj_id": 3}, {"scene_id": 5, "im_id": 0}]"#,
            "entry 1: obj_id not found",
        ),
        (r#"[{"scene_id": 5, "im_id": 0, "obj_id": 4}]"#, "obj_id is 4, expected an object annotated in"),
        (r#"[{"scene_id": 5, "im_id": 0, "obj_id": -4}]"#, "[0].obj_id: -4, expected a whole number"),
        (r#"[{"scene_id": 5, "im_id": null}]"#, "[0].im_id: invalid type: null"),
        (r#"[{"scene_id": 5, "im_id": 0.5}]"#, "[0].im_id: 0.5, expected a whole number"),
        (
            r#"[{"scene_id": 5, "im_id": 0, "obj_id": 3, "inst_count": 99999999999}]"#,
            "inst_count: 99999999999",
        ),
    ] {
        let message = read(text).unwrap_err().to_string();
        assert!(message.contains("test_targets_bop24.json") && message.contains(part), "{text}: {message}");
    }
}

#[test]
fn references_need_annotations_and_targets_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let split = write_split(folder.path());
    let entry = |im_id, ref_im_id| ReferenceTarget {
        scene_id: 5,
        im_id,
        obj_id: 3,
        ref_scene_id: 5,
        ref_im_id,
        rot_deg: None,
        overlap: None,
    };
    check_reference_targets(&[entry(2, 0), entry(1, 0)], "list.json", &split, &split).unwrap();
    let hidden = check_reference_targets(&[entry(1, 0), entry(0, 2)], "list.json", &split, &split);
    let message = hidden.unwrap_err().to_string();
    for part in ["scene_gt.json: image 2 not found", "list.json: entry 1", "--reference-split"] {
        assert!(message.contains(part), "{message}");
    }
    let elsewhere = ReferenceTarget { ref_scene_id: 7, ..entry(1, 0) };
    let message = check_reference_targets(&[elsewhere], "list.json", &split, &split).unwrap_err().to_string();
    assert!(message.contains("ref_scene_id is 7") && message.contains("--reference-split"), "{message}");
}
