//! How runs end that cannot do all: a set without annotations, a disk without room.

use std::{path::Path, process::Command};

use unopose_dataset::formats::{
    ReferenceTarget,
    bop::{BopSceneWriter, SceneImage, SceneInstance},
    detections::{Detection, write_detections},
    rle::Rle,
    targets::write_targets,
};
use unopose_tests::ellipsoid_views::EllipsoidViews;

use super::infer::Files;

/// A target in scene 1, whose annotations are hidden, and its reference in scene 2.
fn hidden_set(root: &Path) {
    let views = EllipsoidViews::new(2, 5);
    for (scene_id, view) in (1..).zip(&views.frames) {
        let mut writer = BopSceneWriter::new(&root.join("test"), scene_id, 0.1, false);
        let instances = view.instances.iter().map(|i| SceneInstance {
            obj_id: i.obj_id,
            t_camera_object: i.t_camera_object,
            mask: i.mask_visib.clone(),
            mask_visib: i.mask_visib.clone(),
            px_count_all: i.px_count_visib,
        });
        writer
            .add(&SceneImage { im_id: 0, frame: view.frame.clone(), instances: instances.collect() })
            .unwrap();
        writer.finish().unwrap();
    }
    for file in ["scene_gt.json", "scene_gt_info.json"] {
        std::fs::remove_file(root.join("test/000001").join(file)).unwrap();
    }
    std::fs::create_dir_all(root.join("models_eval")).unwrap();
    std::fs::write(root.join("models_eval/models_info.json"), r#"{"1": {"diameter": 200}}"#).unwrap();
    let target = ReferenceTarget {
        scene_id: 1,
        im_id: 0,
        obj_id: 1,
        ref_scene_id: 2,
        ref_im_id: 0,
        rot_deg: None,
        overlap: None,
    };
    write_targets(&root.join("references.json"), &[target]).unwrap();
    let detection = Detection {
        scene_id: 1,
        image_id: 0,
        category_id: 1,
        bbox: [0.0; 4],
        score: 0.9,
        time: 0.25,
        segmentation: Rle::encode(&views.frames[0].instances[0].mask_visib),
    };
    write_detections(&root.join("detections.json"), &[detection]).unwrap();
}

#[test]
fn hidden_annotations_give_a_table_without_scores() {
    let files = Files::new();
    let set = files.at("set");
    hidden_set(&set);
    let output = Command::new(env!("CARGO_BIN_EXE_unoinfer"))
        .arg("eval")
        .args([format!("--dataset={}", set.display())])
        .args([format!("--targets={}", set.join("references.json").display())])
        .args([format!("--detections={}", set.join("detections.json").display())])
        .args([format!("--checkpoint={}", files.at("weights.safetensors").display())])
        .args([format!("--out={}", files.at("out").display())])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    assert!(text.contains("no annotations: not scored"), "{text}");
    let tables = std::fs::read_dir(files.at("out")).unwrap().filter_map(|entry| Some(entry.ok()?.path()));
    let tables: Vec<_> = tables.filter(|path| path.extension().is_some_and(|e| e == "csv")).collect();
    assert_eq!(std::fs::read_to_string(&tables[0]).unwrap().lines().count(), 2, "{tables:?}");
    assert!(!files.at("out/scores.json").exists());
}

#[cfg(unix)]
#[test]
fn a_disk_without_room_leaves_the_earlier_results() {
    let files = Files::new();
    assert!(files.estimate(&[], &[]).status.success());
    let results = ["pose.json", "overlay.png"].map(|name| files.at("out").join(name));
    let before = results.each_ref().map(|path| std::fs::read(path).unwrap());
    // No file may grow beyond 1 KB; the write fails as on a full disk.
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -f 1 && trap '' XFSZ && exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_unoinfer")]);
    let named = [
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
    command.arg("estimate");
    command.args(named.iter().flat_map(|(flag, file)| [(*flag).into(), files.at(file).into_os_string()]));
    let output = command.output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("pose.json"), "{message}");
    assert_eq!(results.each_ref().map(|path| std::fs::read(path).unwrap()), before);
    let left: Vec<_> = std::fs::read_dir(files.at("out")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}
