//! The library's way in, [`PoseEstimator`], on two views of ellipsoids with an untrained network, and a target list.

use std::{fmt::Write, path::Path};

use burn::tensor::TensorData;
use unopose_core::{config::Config, frame::Mask};
use unopose_dataset::{
    formats::{
        DatasetSplits, ReferenceTarget, Target,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
        detections::{Detection, write_detections},
        results::read_results,
        rle::Rle,
        targets::write_targets,
    },
    protocol::{TargetFiles, TargetList},
};
use unopose_eval::metrics::{score_poses, write_poses};
use unopose_infer::{
    Estimate, InferError, PoseEstimator, Query, Refinement, estimate_targets, experiment::ReferenceColor,
};
use unopose_nn::{checkpoint::TensorFile, device::DeviceChoice, model::UnoPose};
use unopose_tests::ellipsoid_views::{EllipsoidViews, HALF_AXES};

fn estimator(seed: u64) -> PoseEstimator {
    let (device, _) = DeviceChoice::Auto.open().unwrap();
    let config = Config::embedded("smoke", &[]).unwrap();
    let model = UnoPose::new(&config.model, 3, &device);
    PoseEstimator::from_model(model, config.model, device).with_seed(seed)
}

/// Pose and score, bit for bit.
fn bits(estimate: &Estimate) -> Vec<u64> {
    let pose = &estimate.t_query_reference;
    let numbers = pose.rotation.iter().chain(&pose.translation).chain([&estimate.score, &estimate.matched]);
    numbers.map(|x| x.to_bits()).collect()
}

#[test]
fn a_kept_reference_gives_the_same_pose_and_is_refused_by_another_network() {
    let views = EllipsoidViews::new(2, 1);
    let [query, other] = [&views.frames[0], &views.frames[1]];
    let estimator = estimator(7).with_refinement(Refinement::Icp);
    let reference = estimator.reference(&other.frame, &other.instances[0].mask_visib).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.safetensors");
    estimator.save_reference(&reference, &path).unwrap();
    let kept = estimator.load_reference(&path).unwrap();
    let masks = std::slice::from_ref(&query.instances[0].mask_visib);
    let pose = |reference| bits(estimator.estimate(reference, &query.frame, masks)[0].as_ref().unwrap());
    assert_eq!(pose(&kept), pose(&reference));
    assert_eq!((kept.points(), kept.radius()), (reference.points(), reference.radius()));

    let (device, _) = DeviceChoice::Auto.open().unwrap();
    let config = Config::embedded("smoke", &[]).unwrap();
    let retrained = UnoPose::new(&config.model, 4, &device);
    let retrained = PoseEstimator::from_model(retrained, config.model, device);
    let message = retrained.load_reference(&path).err().unwrap().to_string();
    assert!(message.contains("kept.safetensors: network is"), "{message}");

    let good = TensorFile::read(&path).unwrap();
    let refused = |field: &str, value: f32| {
        let mut file = TensorFile { tensors: good.tensors.clone(), metadata: good.metadata.clone() };
        let shape = file.tensors[field].shape().to_vec();
        let values = TensorData::new(vec![value; shape.iter().product()], shape);
        file.tensors.insert(field.into(), values);
        file.write(&path).unwrap();
        estimator.load_reference(&path).err().unwrap().to_string()
    };
    // Damage that reaches the tables of the structure embedding would index and allocate by these values.
    for (field, value, expected) in [
        ("choose", 0.5, "whole numbers below 1024"),
        ("distances", -1.0, "values from 0 to 10000"),
        ("distances", 1e30, "values from 0 to 10000"),
        ("angles", 1e9, "values from 0 to 12.01"),
        ("radius", 0.0, "values from 0.0001 to 1000"),
        ("measured", 1e6, "values from -1000 to 1000"),
    ] {
        let message = refused(field, value);
        assert!(message.contains(&format!("{field} is {value}, expected {expected}")), "{message}");
    }
    assert!(refused("features", f32::NAN).contains("contains NaN or infinity"));
}

#[test]
fn a_pose_depends_on_its_pair_and_the_seed_alone() {
    let views = EllipsoidViews::new(2, 1);
    let [query, other] = [&views.frames[0], &views.frames[1]];
    let masks: Vec<Mask> = query.instances.iter().map(|i| i.mask_visib.clone()).collect();
    let estimator = estimator(7);
    let references: Vec<_> =
        other.instances.iter().map(|i| estimator.reference(&other.frame, &i.mask_visib).unwrap()).collect();
    let alone = bits(estimator.estimate(&references[0], &query.frame, &masks[..1])[0].as_ref().unwrap());
    let both = estimator.estimate(&references[0], &query.frame, &masks);
    assert_eq!(bits(both[0].as_ref().unwrap()), alone);
    // Nine instances are two forward passes; different references share a batch.
    let frame = &query.frame;
    let mut queries = vec![Query { reference: &references[1], frame, mask: &masks[1] }; 8];
    queries.push(Query { reference: &references[0], frame, mask: &masks[0] });
    let batch = estimator.estimate_batch(&queries);
    assert_eq!(bits(batch[8].as_ref().unwrap()), alone);
    assert_eq!(bits(batch[0].as_ref().unwrap()), bits(batch[7].as_ref().unwrap()));

    let again = self::estimator(7);
    let reference = again.reference(&other.frame, &other.instances[0].mask_visib).unwrap();
    assert_eq!(bits(again.estimate(&reference, frame, &masks[..1])[0].as_ref().unwrap()), alone);
    let reseeded = self::estimator(8);
    let reference = reseeded.reference(&other.frame, &other.instances[0].mask_visib).unwrap();
    assert_ne!(bits(reseeded.estimate(&reference, frame, &masks[..1])[0].as_ref().unwrap()), alone);
}

#[test]
fn estimates_are_rigid_and_their_shares_are_shares() {
    let views = EllipsoidViews::new(2, 2);
    let [query, other] = [&views.frames[0], &views.frames[1]];
    let estimator = estimator(0).with_refinement(Refinement::Icp);
    let reference = estimator.reference(&other.frame, &other.instances[1].mask_visib).unwrap();
    assert!((0.04..0.12).contains(&reference.radius()), "{}", reference.radius());
    let measured = |z: &&f32| **z > 0.0;
    let depths = other.frame.depth.data.iter().zip(&other.instances[1].mask_visib.data);
    let points = depths.filter(|&(z, &m)| m && measured(&z)).count();
    assert_eq!(reference.points().len(), points);
    let mask = &query.instances[1].mask_visib;
    let estimate =
        estimator.estimate(&reference, &query.frame, std::slice::from_ref(mask)).remove(0).unwrap();
    let Estimate { t_query_reference: pose, score, overlap, matched, timings, .. } = &estimate;
    assert!(pose.rotation_defect() < 1e-6, "{pose:?}");
    assert!(
        [*score, *matched, overlap[0], overlap[1]].iter().all(|x| (0.0..=1.0).contains(x)),
        "{estimate:?}"
    );
    assert!(timings.total > 0.0 && timings.total >= timings.prepare + timings.refine, "{timings:?}");
    // The query is where its points are, however wrong the rotation of an untrained network.
    let center = |points: &[[f32; 3]]| -> [f32; 3] {
        std::array::from_fn(|i| points.iter().map(|p| p[i]).sum::<f32>() / points.len() as f32)
    };
    let moved = pose.transform_f32(&center(reference.points()));
    let there = center(&query.frame.masked_points(mask));
    let distance = (0..3).map(|i| (moved[i] - there[i]).powi(2)).sum::<f32>().sqrt();
    assert!(distance < 0.15, "{distance} m");
}

#[test]
fn unusable_instances_do_not_stop_the_others() {
    let views = EllipsoidViews::new(2, 3);
    let frame = &views.frames[0].frame;
    let good = views.frames[0].instances[0].mask_visib.clone();
    let estimator = estimator(0);
    let reference = estimator.reference(frame, &good).unwrap();
    let empty = Mask::empty(320, 240);
    let small = Mask::empty(32, 24);
    let results = estimator.estimate(&reference, frame, &[empty.clone(), good.clone(), small]);
    assert!(results[1].is_ok());
    let message = |i: usize| results[i].as_ref().unwrap_err().to_string();
    assert!(message(0).contains("mask is empty"), "{}", message(0));
    assert!(message(2).contains("32 x 24") && message(2).contains("320 x 240"), "{}", message(2));
    assert!(matches!(estimator.reference(frame, &empty), Err(InferError::Reference(_))));
    // Millimetres read as metres.
    let mut far = frame.clone();
    far.depth.data.iter_mut().for_each(|z| *z *= 1000.0);
    let message = estimator.reference(&far, &good).err().unwrap().to_string();
    assert!(message.contains("radius") && message.contains("depth_scale"), "{message}");
    assert!(estimator.estimate(&reference, &far, &[good])[0].is_err());
}

#[test]
fn a_target_list_becomes_a_table_and_scores() {
    let folder = tempfile::tempdir().unwrap();
    let list = bop_folder(folder.path());
    let estimator = estimator(1);
    let mut seen = Vec::new();
    let poses = estimate_targets(&estimator, &list, ReferenceColor::Keep, &mut |done, total| {
        seen.push((done, total))
    });
    assert_eq!(seen, [(0, 2), (1, 2), (2, 2)]);
    // Image 0: both objects, of object 1 only the confident detection. Image 1: the confident detection of object 2 is
    // empty and put aside, so that the best of the others is taken; object 1 has no detection.
    let found: Vec<_> = poses.results.iter().map(|r| (r.im_id, r.obj_id)).collect();
    assert_eq!(found, [(0, 1), (0, 2), (1, 2)]);
    assert_eq!((poses.pairs, poses.references), (3, 2));
    assert_eq!(poses.reasons(), [("no detection".to_owned(), 1)]);
    assert_eq!((poses.rejections[0].im_id, poses.rejections[0].obj_id), (1, 1));
    let skipped = &list.skipped[0];
    assert_eq!((list.skipped.len(), skipped.entry, skipped.im_id, skipped.obj_id), (1, 5, 1, 2));
    assert!(skipped.reason.contains("segmentation is empty"), "{}", skipped.reason);
    // The times of image 0 are known: 0.25 s for the detections, and ours. In image 1 they are not.
    assert!(poses.results[0].time > 0.25 && poses.results[0].time == poses.results[1].time);
    assert_eq!(poses.results[2].time, -1.0);
    assert!((poses.mean_time_per_pair_s().unwrap() - poses.seconds / 3.0).abs() < 1e-12);

    let again = estimate_targets(&self::estimator(1), &list, ReferenceColor::Keep, &mut |_, _| {});
    let of = |poses: &[unopose_dataset::formats::PoseResult]| -> Vec<_> {
        poses.iter().map(|r| (r.score.to_bits(), r.t_camera_object)).collect()
    };
    assert_eq!(of(&again.results), of(&poses.results));

    let out = folder.path().join("out");
    let table = write_poses(&list, &poses, "unopose", &out).unwrap();
    let name = format!("unopose_{}-test.csv", list.dataset.name());
    assert_eq!(table.file_name().unwrap().to_str().unwrap(), name);
    assert_eq!(read_results(&table).unwrap().len(), 3);
    let evaluation = score_poses(&list, &poses, None, &|_, _| {}).unwrap();
    evaluation.write(&out).unwrap();
    let scores: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("scores.json")).unwrap()).unwrap();
    assert_eq!((scores["n_targets"].as_u64(), scores["n_estimates"].as_u64()), (Some(4), Some(3)));
    assert_eq!(scores["mean_time_per_image_s"], -1.0);
    // serde_json may read a decimal one unit in the last place off.
    let written = scores["mean_time_per_pair_s"].as_f64().unwrap();
    assert!((written / poses.mean_time_per_pair_s().unwrap() - 1.0).abs() < 1e-12, "{written}");
    for key in ["AR", "AR_VSD", "AR_MSSD", "AR_MSPD"] {
        assert!((0.0..=0.75).contains(&scores[key].as_f64().unwrap()), "{key}: {}", scores[key]);
    }
}

#[test]
fn a_view_that_cannot_be_read_costs_its_own_targets() {
    let folder = tempfile::tempdir().unwrap();
    let list = bop_folder(folder.path());
    let estimator = estimator(1);
    let run = || estimate_targets(&estimator, &list, ReferenceColor::Keep, &mut |_, _| {});
    let whole = run();
    let depth = |im_id: u32| folder.path().join(format!("test/000001/depth/{im_id:06}.png"));
    std::fs::rename(depth(1), folder.path().join("kept.png")).unwrap();
    let part = run();
    assert_eq!(part.results.len(), 2);
    for (a, b) in part.results.iter().zip(&whole.results) {
        assert_eq!(
            (a.im_id, a.obj_id, a.score.to_bits(), a.t_camera_object),
            (0, b.obj_id, b.score.to_bits(), b.t_camera_object)
        );
    }
    assert_eq!(part.reasons(), [("image cannot be read: depth not found".to_owned(), 2)]);
    assert!(part.unread.messages()["scene 1 image 1"].contains("depth/000001.png"));
    let scores = score_poses(&list, &part, None, &|_, _| {}).unwrap().scores;
    assert_eq!((scores.recall.n_targets, scores.n_estimates, scores.input.unread_images.len()), (4, 2, 1));
    // The view of all references.
    std::fs::rename(folder.path().join("kept.png"), depth(1)).unwrap();
    std::fs::write(depth(2), "no image").unwrap();
    let none = run();
    assert!(none.results.is_empty());
    assert_eq!(none.reasons()[0], ("reference cannot be read: not a readable image".to_owned(), 3));
    assert_eq!(none.unread.len(), 1);
}

/// A dataset of four ellipsoid views: images 0 and 1 of scene 1 are targets, image 2 holds the references.
fn bop_folder(root: &Path) -> TargetList {
    let views = EllipsoidViews::new(3, 4);
    let mut writer = BopSceneWriter::new(&root.join("test"), 1, 0.1, false);
    for (im_id, view) in (0..).zip(&views.frames) {
        let instances = view.instances.iter().map(|i| SceneInstance {
            obj_id: i.obj_id,
            t_camera_object: i.t_camera_object,
            mask: i.mask_visib.clone(),
            mask_visib: i.mask_visib.clone(),
            px_count_all: i.px_count_visib,
        });
        writer.add(&SceneImage { im_id, frame: view.frame.clone(), instances: instances.collect() }).unwrap();
    }
    writer.finish().unwrap();
    std::fs::create_dir_all(root.join("models_eval")).unwrap();
    let mut info = serde_json::Map::new();
    for (obj_id, half_axes) in (1..).zip(HALF_AXES) {
        std::fs::write(root.join(format!("models_eval/obj_{obj_id:06}.ply")), ellipsoid_ply(half_axes))
            .unwrap();
        let diameter = 2000.0 * half_axes.iter().copied().fold(0.0, f64::max);
        info.insert(obj_id.to_string(), serde_json::json!({ "diameter": diameter }));
    }
    std::fs::write(root.join("models_eval/models_info.json"), serde_json::to_vec(&info).unwrap()).unwrap();

    let targets: Vec<ReferenceTarget> = [(0, 1), (0, 2), (1, 1), (1, 2)]
        .map(|(im_id, obj_id)| ReferenceTarget {
            scene_id: 1,
            im_id,
            obj_id,
            ref_scene_id: 1,
            ref_im_id: 2,
            rot_deg: None,
            overlap: None,
        })
        .to_vec();
    write_targets(&root.join("references.json"), &targets).unwrap();
    let bop: Vec<Target> = targets
        .iter()
        .map(|t| Target { scene_id: 1, im_id: t.im_id, obj_id: t.obj_id, inst_count: 1 })
        .collect();
    write_targets(&root.join("test_targets_bop19.json"), &bop).unwrap();
    let detection = |image_id: u32, category_id: u32, score, time, mask: &Mask| Detection {
        scene_id: 1,
        image_id,
        category_id,
        bbox: [0.0; 4],
        score,
        time,
        segmentation: Rle::encode(mask),
    };
    let mask = |image: usize, object: usize| &views.frames[image].instances[object - 1].mask_visib;
    let detections = [
        detection(0, 1, 0.2, 0.25, mask(0, 2)),
        detection(0, 1, 0.9, 0.25, mask(0, 1)),
        detection(0, 2, 0.1, 0.25, mask(0, 2)),
        detection(1, 2, 0.15, -1.0, mask(1, 1)),
        detection(1, 2, 0.2, -1.0, mask(1, 2)),
        detection(1, 2, 0.8, -1.0, &Mask::empty(320, 240)),
    ];
    write_detections(&root.join("detections.json"), &detections).unwrap();
    TargetList::open(&TargetFiles {
        splits: DatasetSplits { dataset: root.to_owned(), ..DatasetSplits::default() },
        targets: root.join("references.json"),
        detections: root.join("detections.json"),
        limit: None,
    })
    .unwrap()
}

/// Longitudes and latitudes of an ellipsoid, millimetres.
fn ellipsoid_ply(half_axes: [f64; 3]) -> String {
    const STEPS: usize = 12;
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (STEPS + 1) * 2 * STEPS,
        4 * STEPS * STEPS
    );
    for row in 0..=STEPS {
        for col in 0..2 * STEPS {
            let [latitude, longitude] = [row, col].map(|i| i as f64 * std::f64::consts::PI / STEPS as f64);
            let unit = [latitude.sin() * longitude.cos(), latitude.sin() * longitude.sin(), latitude.cos()];
            let [x, y, z]: [f64; 3] = std::array::from_fn(|i| 1000.0 * half_axes[i] * unit[i]);
            writeln!(text, "{x} {y} {z}").unwrap();
        }
    }
    let index = |row: usize, col: usize| row * 2 * STEPS + col % (2 * STEPS);
    for row in 0..STEPS {
        for col in 0..2 * STEPS {
            let [a, b, c, d] =
                [(row, col), (row + 1, col), (row + 1, col + 1), (row, col + 1)].map(|(r, c)| index(r, c));
            writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}").unwrap();
        }
    }
    text
}
