//! Samples of datasets.

use std::path::Path;

use unopose_dataset::formats::bop::{BopSceneWriter, SceneImage, SceneInstance};

use super::*;

/// A scene of six images, with the unit of their depth in `scene_camera.json`.
fn write_set(root: &Path) {
    let shot = shot();
    let mut writer = BopSceneWriter::new(&root.join("test"), 4, 0.1, false);
    for im_id in 0..6 {
        let instance = SceneInstance {
            obj_id: 3,
            t_camera_object: shot.t_camera_object,
            mask: shot.mask.clone(),
            mask_visib: shot.mask.clone(),
            px_count_all: shot.mask.count() as u32,
        };
        writer.add(&SceneImage { im_id, frame: shot.frame.clone(), instances: vec![instance] }).unwrap();
    }
    writer.finish().unwrap();
}

fn examine(root: &Path, images: usize) -> DatasetReport {
    examine_dataset(root, &Sampling { images, split: None, sensor: None, points: 1024 }).unwrap()
}

fn level(report: &DatasetReport, check: Check) -> Level {
    report.summaries().iter().find(|summary| summary.check == check).unwrap().level
}

#[test]
fn a_set_is_sampled_and_summarised() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let report = examine(folder.path(), 3);
    assert_eq!((report.images, report.instances.len()), (3, 3));
    assert!(report.instances[1].place.ends_with("image 2, instance 0 (object 3)"), "{:?}", report.instances);
    for summary in report.summaries() {
        assert_eq!((summary.counts, summary.level), ([3, 0, 0], Level::Ok), "{summary:?}");
    }
    assert!(report.worst(3).is_empty());

    // An image without depth is one of six: the set is told to be wrong there.
    std::fs::remove_file(folder.path().join("test/000004/depth/000003.png")).unwrap();
    let report = examine(folder.path(), 99);
    assert_eq!((report.images, report.instances.len()), (6, 6));
    assert_eq!((level(&report, Check::Images), level(&report, Check::Unit)), (Level::Wrong, Level::Ok));
    let [(place, finding)] = report.worst(3)[..] else { panic!("{:?}", report.worst(3)) };
    assert!(place.ends_with("image 3") && finding.text.contains("depth"), "{finding}");
}

#[test]
fn a_unit_that_the_poses_contradict_is_named() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let cameras = folder.path().join("test/000004/scene_camera.json");
    let text = std::fs::read_to_string(&cameras).unwrap();
    std::fs::write(&cameras, text.replace("\"depth_scale\":0.1", "\"depth_scale\":1.0")).unwrap();
    let report = examine(folder.path(), 6);
    assert_eq!((level(&report, Check::Annotation), level(&report, Check::Unit)), (Level::Wrong, Level::Look));
    let worst = report.worst(1);
    let advice = |check: Check| &worst.iter().find(|(_, finding)| finding.check == check).unwrap().1.advice;
    assert!(advice(Check::Unit).contains("depth_scale of 0.1 instead of 1"), "{}", advice(Check::Unit));
    assert!(advice(Check::Annotation).contains("about 0.1"), "{}", advice(Check::Annotation));
}
