//! A synthetic dataset of two images of one square, a method whose poses and failures are known, and runs that are resumed.

mod lists;
mod networks;
mod sequences;
mod unoseg_masks;

use std::{
    io::Write,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    files::write_atomic,
    frame::{DepthMap, Mask, MaskedView, RgbdFrame},
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::{
    formats::{
        DatasetSplits, ModelInfo, ObjectSymmetries, ReferenceTarget,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
        detections::{Detection, write_detections},
        models::write_models_info,
        rle::Rle,
        targets::write_targets,
    },
    mesh::{TriangleMesh, ply},
    protocol::{TargetFiles, TargetList},
};
use unopose_eval::metrics::score_poses;
use unopose_pairs::registration::{PairEstimator, PairPose, Refined, Refinement, RegistrationError};

use super::{comparison::Comparison, examples::Examples, report::write_report, run::run_method, *};

fn at(x: f64) -> Pose {
    Pose::new(Matrix3::identity(), Vector3::new(x, 0.0, 1.0))
}

/// In a folder `ycbv`: images 0, 1 and 2 show the square at x = 0, 0.1 and 0.2 m; 0 is the reference of the others, whose
/// masks are right, and of another size.
fn write_dataset(folder: &Path) -> TargetList {
    let root = &folder.join("ycbv");
    let mut writer = BopSceneWriter::new(&root.join("test"), 1, 0.1, false);
    let mut mask = Mask::empty(64, 64);
    for row in 22..42 {
        mask.data[row * 64 + 22..row * 64 + 42].fill(true);
    }
    for im_id in 0..3 {
        let instance = SceneInstance {
            obj_id: 1,
            t_camera_object: at(0.1 * f64::from(im_id)),
            mask: mask.clone(),
            mask_visib: mask.clone(),
            px_count_all: 400,
        };
        let frame = RgbdFrame {
            rgb: image::RgbImage::new(64, 64),
            depth: DepthMap::zeros(64, 64),
            intrinsics: Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 },
        };
        writer.add(&SceneImage { im_id, frame, instances: vec![instance] }).unwrap();
    }
    writer.finish().unwrap();
    let square = TriangleMesh {
        vertices: vec![[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    };
    let info = ModelInfo {
        diameter: 0.2 * 2f64.sqrt(),
        min: Vector3::new(-0.1, -0.1, 0.0),
        size: Vector3::new(0.2, 0.2, 0.0),
        symmetries: ObjectSymmetries::default(),
    };
    write_models_info(&root.join("models_eval/models_info.json"), &[(1, info)].into()).unwrap();
    let model = root.join("models_eval/obj_000001.ply");
    write_atomic(&model, |out| ply::write(&square, 1000.0, None, out)).unwrap();
    write_atomic(&root.join("models/obj_000001.ply"), |out| ply::write(&square, 1000.0, None, out)).unwrap();
    let target = |im_id| ReferenceTarget {
        scene_id: 1,
        im_id,
        obj_id: 1,
        ref_scene_id: 1,
        ref_im_id: 0,
        rot_deg: None,
        overlap: None,
    };
    let detection = |image_id, mask: &Mask| Detection {
        scene_id: 1,
        image_id,
        category_id: 1,
        bbox: [0.0; 4],
        score: 0.9,
        time: 0.5,
        segmentation: Rle::encode(mask),
    };
    write_targets(&root.join("targets.json"), &[target(1), target(2)]).unwrap();
    let small = Mask { data: vec![true; 100], ..Mask::empty(10, 10) };
    write_detections(&root.join("dets.json"), &[detection(1, &mask), detection(2, &small)]).unwrap();
    TargetList::open(&TargetFiles {
        splits: DatasetSplits { dataset: root.to_path_buf(), ..DatasetSplits::default() },
        targets: root.join("targets.json"),
        detections: root.join("dets.json"),
        limit: None,
    })
    .unwrap()
}

/// Knows the answer for image 1, and counts how often it is asked.
struct Shift {
    asked: AtomicUsize,
}

impl PairEstimator for Shift {
    fn name(&self) -> String {
        "shift".into()
    }

    fn fingerprint(&self) -> String {
        "0.1 m".into()
    }

    fn estimate(&self, _: MaskedView, _: MaskedView) -> Result<PairPose, RegistrationError> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let t_query_reference = Pose::new(Matrix3::identity(), Vector3::new(0.1, 0.0, 0.0));
        Ok(PairPose { t_query_reference, score: 0.5, seconds: 0.25, confidence: None })
    }
}

#[test]
fn an_image_that_cannot_be_read_costs_itself_until_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_dataset(folder.path());
    let (cache, method) = (folder.path().join("results"), Shift { asked: AtomicUsize::new(0) });
    let refined = Refined { estimator: &method, refinement: Refinement::None };
    let go = || run_method(&list, &refined, &cache, &mut |_, _| {}).unwrap();
    for (gone, im_id) in [("rgb/000001.png", 1), ("depth/000000.png", 0)] {
        let path = folder.path().join("ycbv/test/000001").join(gone);
        let content = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let run = go();
        assert_eq!((run.poses.results.len(), run.computed, run.poses.rejections.len()), (0, 0, 2));
        let kind = gone.split('/').next().unwrap();
        let reason = &run.poses.rejections[0].reason;
        assert!(reason.starts_with("image cannot be read: ") && reason.contains(kind), "{reason}");
        let messages = run.poses.unread.messages();
        let message = &messages[&format!("scene 1 image {im_id}")];
        assert!(message.contains(&format!("{im_id:06}.png")), "{message}");
        std::fs::write(&path, content).unwrap();
    }
    assert_eq!(go().poses.results.len(), 1);
}

#[test]
fn a_run_is_resumed_scored_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_dataset(folder.path());
    let (cache, method) = (folder.path().join("results"), Shift { asked: AtomicUsize::new(0) });
    let refined = Refined { estimator: &method, refinement: Refinement::None };
    let go = || run_method(&list, &refined, &cache, &mut |_, _| {}).unwrap();
    let first = go();
    assert_eq!((first.computed, method.asked.load(Ordering::Relaxed)), (1, 1));
    assert_eq!((first.poses.pairs, first.poses.results.len(), first.poses.rejections.len()), (1, 1, 1));
    assert_eq!(first.poses.rejections[0].reason, "no detection");
    assert!(list.skipped[0].reason.contains("10 x 10, expected the image's 64 x 64"));
    let result = &first.poses.results[0];
    assert!(result.t_camera_object.translation_distance(&at(0.1)) < 1e-9);
    assert!((result.score - 0.45).abs() < 1e-12 && (result.time - 0.75).abs() < 1e-12);

    // Known now; a line that was being written when the program was killed is estimated again.
    assert_eq!(go().computed, 0);
    let file = std::fs::read_dir(&cache).unwrap().next().unwrap().unwrap().path();
    std::fs::OpenOptions::new().append(true).open(&file).unwrap().write_all(b"{\"scene_id\":1,").unwrap();
    let again = go();
    assert_eq!((again.computed, &again.poses.results), (0, &first.poses.results));
    assert!(std::fs::read_to_string(&file).unwrap().ends_with("}\n"));

    // Another refinement starts from the known pose; without measured points it leaves it as it is.
    let icp = Refined { refinement: Refinement::Icp, ..refined };
    let after = run_method(&list, &icp, &cache, &mut |_, _| {}).unwrap();
    assert_eq!(
        (after.name.as_str(), after.computed, method.asked.load(Ordering::Relaxed)),
        ("shift-icp", 1, 1)
    );
    assert_eq!(after.poses.results[0].t_camera_object, first.poses.results[0].t_camera_object);

    let evaluation = score_poses(&list, &first.poses, None, &|_, _| {}).unwrap();
    assert_eq!(evaluation.scores.recall.ar, 0.5);
    let out = folder.path().join("out");
    let examples = [Examples::draw(&list, &first, &evaluation, &out).unwrap()];
    let facts = ListFacts { list: "rot50".into(), segmentation: "dets".into(), ..ListFacts::default() };
    let runs = [(first.clone(), evaluation.clone()), (first, evaluation)];
    let comparison = Comparison::new(&facts, &list, &runs, 3);
    let score = &comparison.methods[0];
    assert_eq!((score.targets_without_pose, score.pairs, score.ar.value), (1, 1, 0.5));
    assert_eq!((score.ar.low, score.ar.high), (0.0, 1.0));
    assert_eq!(comparison.differences[0].ar.low, 0.0);
    write_report(&comparison, &examples, &out).unwrap();
    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let table = text("table.md");
    assert!(table.contains("| shift | 50.0 | 0.0 .. 100.0 | 50.0 | 50.0 | 50.0 | 0.250 | 1 |"), "{table}");
    assert!(
        table.contains("| UNOPose | UNOSeg-SAM | 83.1 | 3.70 |")
            && table.contains("1 x segmentation size is 10 x 10")
            && table.contains("(first: entry 1, scene 1 image 2 object 1)"),
        "{table}"
    );
    // The same seed gives the same table, another one other intervals at most.
    write_report(&Comparison::new(&facts, &list, &runs, 3), &examples, &folder.path().join("again")).unwrap();
    for name in ["table.md", "table.csv", "table.json", "index.html"] {
        assert_eq!(
            text(name),
            std::fs::read_to_string(folder.path().join("again").join(name)).unwrap(),
            "{name}"
        );
    }
    let value: serde_json::Value =
        unopose_dataset::formats::files::read_json(&out.join("table.json")).unwrap();
    assert_eq!((value["seed"].as_u64(), value["list"].as_str()), (Some(3), Some("rot50")));
    assert!(text("table.csv").contains("shift,0.500000,0.000000,1.000000"));
    assert!(text("index.html").contains("shift-worst.png") && out.join("shift-worst.png").is_file());
    assert!(out.join("recall.svg").is_file());
}
