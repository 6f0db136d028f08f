//! Training pairs and their stream on analytic views with known poses.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::{DataConfig, ModelConfig, Quirks},
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::formats::megapose::ShardDataset;
use unopose_pairs::data::{
    BatchStream, DataError, PairSampler, TrainSample, metric_pose, normalised_pose, overlap_share,
    prepare_query, prepare_reference,
};
use unopose_tests::ellipsoid_views::{EllipsoidViews, HALF_AXES};

fn model() -> ModelConfig {
    ModelConfig {
        image_size: 56,
        reference_points: 600,
        fine_points: 256,
        coarse_points: 48,
        ..ModelConfig::default()
    }
}

fn sampler_of(views: EllipsoidViews, data: &DataConfig, model: &ModelConfig) -> PairSampler {
    PairSampler::new(Arc::new(views), data, model, 11).unwrap()
}

fn sampler() -> Arc<PairSampler> {
    Arc::new(sampler_of(EllipsoidViews::new(6, 1), &DataConfig::default(), &model()))
}

type Fingerprint = (u64, Vec<[f32; 3]>, Vec<f32>, Vec<u32>, [f64; 9]);

/// Everything random about a sample.
fn fingerprint(sample: &TrainSample) -> Fingerprint {
    let points = sample.query.points.iter().chain(&sample.reference.cloud.points).copied().collect();
    let choose = [&sample.query.choose[..], &sample.reference.cloud.sparse].concat();
    let rgb = [&sample.query.rgb[..], &sample.reference.cloud.rgb].concat();
    (sample.key.index, points, rgb, choose, sample.t_init.rotation_row_major())
}

#[test]
fn metric_and_normalised_poses_are_inverse() {
    let rotation = *nalgebra::Rotation3::new(Vector3::new(0.3, -1.1, 0.4)).matrix();
    let pose = Pose::new(rotation, Vector3::new(0.02, -0.1, 0.5));
    let (query, reference, radius) = ([0.1, 0.2, 0.7], [-0.1, 0.05, 0.9], 0.085);
    let back = metric_pose(&normalised_pose(&pose, query, reference, radius), query, reference, radius);
    assert!(back.translation_distance(&pose) < 1e-12);
    assert_eq!(back.rotation, pose.rotation);
}

#[test]
fn labels_put_the_reference_on_the_query_object() {
    for quirks in [Quirks::corrected(), Quirks { keep_zero_depth: false, ..Quirks::release() }] {
        let views = EllipsoidViews::new(6, 1);
        let truth = EllipsoidViews::new(6, 1);
        let model = ModelConfig { quirks: quirks.clone(), ..model() };
        let sampler = sampler_of(views, &DataConfig::default(), &model);
        for index in 0..12 {
            let sample = sampler.sample(index, false).unwrap();
            let (key, cloud) = (sample.key, &sample.reference.cloud);
            assert!(quirks.same_image_reference || key.query_image != key.reference_image);
            let metric = metric_pose(
                &sample.t_query_reference,
                sample.query.center,
                cloud.center,
                sample.reference.radius,
            );
            let t_object_query = truth.pose(key.query_image, key.query_instance).inverse();
            let on_surface = |p: Point3<f64>| {
                let axes = Vector3::from(HALF_AXES[key.obj_id as usize - 1]);
                (p.coords.component_div(&axes).norm() - 1.0).abs()
            };
            let meters = |p: &[f32; 3], center: [f32; 3]| {
                let scale = sample.reference.radius + 1e-6;
                Point3::from(std::array::from_fn(|i| (p[i] * scale + center[i]) as f64))
            };
            for p in &sample.query.points {
                assert!(on_surface(t_object_query.transform(&meters(p, sample.query.center))) < 1e-4);
            }
            for p in &cloud.points {
                let in_query = metric.transform(&meters(p, cloud.center));
                assert!(on_surface(t_object_query.transform(&in_query)) < 1e-4);
            }
        }
    }
}

#[test]
fn augmented_labels_still_align_the_clouds() {
    let sampler = sampler();
    let turn = Pose::new(*nalgebra::Rotation3::new(Vector3::z() * 0.3).matrix(), Vector3::zeros());
    let (mut aligned, mut turned) = (0.0, 0.0);
    for index in 0..12 {
        let sample = sampler.sample(index, true).unwrap();
        let share =
            |pose: &Pose| overlap_share(&sample.query.points, &sample.reference.cloud.points, pose, 0.08);
        aligned += share(&sample.t_query_reference);
        turned += share(&(sample.t_query_reference * turn));
        let noise = sample.t_init.rotation_angle_deg(&sample.t_query_reference);
        assert!(noise > 0.0 && noise < 3f64.sqrt() * 45.0 + 1.0);
        assert_eq!(sample.query_groups[0].counts.len(), sample.query.points.len());
    }
    assert!(aligned > turned + 0.5, "{aligned} {turned}");
}

#[test]
fn release_keeps_pixels_without_depth() {
    let radius = |keep_zero_depth| {
        let model = ModelConfig { quirks: Quirks { keep_zero_depth, ..Quirks::release() }, ..model() };
        let views = EllipsoidViews::new(3, 1);
        let frame = &views.frames[0];
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        prepare_reference(&frame.frame, &frame.instances[0].mask_visib, &model, &mut rng).unwrap().radius
    };
    assert!(radius(true) > 0.5, "a point at the camera makes the radius the camera's distance");
    assert!(radius(false) < 0.12);
}

#[test]
fn samples_do_not_depend_on_the_thread_or_the_history() {
    let first = sampler();
    let expected: Vec<_> = (0..6).map(|i| fingerprint(&first.sample(i, true).unwrap())).collect();
    let second = sampler();
    let threads: Vec<_> = (0..6)
        .rev()
        .map(|i| {
            let sampler = second.clone();
            std::thread::spawn(move || fingerprint(&sampler.sample(i, true).unwrap()))
        })
        .collect();
    for (thread, expected) in threads.into_iter().rev().zip(&expected) {
        assert!(thread.join().unwrap() == *expected);
    }
    assert!(expected[0] != expected[1]);
}

#[test]
fn the_stream_is_in_order_and_resumes() {
    let sampler = sampler();
    let mut stream = BatchStream::new(sampler.clone(), 0, 3, 3, 2);
    let batches: Vec<_> = stream.by_ref().take(4).map(Result::unwrap).collect();
    assert_eq!(stream.position(), 12);
    let order: Vec<u64> = batches.iter().flatten().map(|s| s.key.index).collect();
    assert_eq!(order, (0..12).collect::<Vec<_>>());
    drop(stream);
    let mut resumed = BatchStream::new(sampler.clone(), 9, 3, 1, 0);
    let again = resumed.next().unwrap().unwrap();
    for (a, b) in again.iter().zip(&batches[3]) {
        assert!(fingerprint(a) == fingerprint(b));
    }
}

#[test]
fn unreadable_images_are_replaced_and_counted() {
    let mut views = EllipsoidViews::new(6, 1);
    views.broken = vec![0, 3];
    let sampler = sampler_of(views, &DataConfig::default(), &model());
    for index in 0..20 {
        let key = sampler.sample(index, false).unwrap().key;
        assert!(![0, 3].contains(&key.query_image) && ![0, 3].contains(&key.reference_image));
    }
    assert!(sampler.rejected() > 0);
}

#[test]
fn an_error_ends_the_stream() {
    let mut views = EllipsoidViews::new(3, 1);
    views.broken = vec![0, 1, 2];
    let sampler = sampler_of(views, &DataConfig::default(), &model());
    let mut stream = BatchStream::new(Arc::new(sampler), 5, 2, 2, 1);
    let error = stream.next().unwrap().unwrap_err();
    assert!(matches!(error, DataError::Exhausted { index: 5, .. }), "{error}");
    assert!(error.to_string().contains("rgb not found"), "{error}");
    assert!(stream.next().is_none());
}

#[test]
fn limits_on_rotation_and_overlap_hold() {
    let data = DataConfig { max_rotation_deg: 70.0, min_overlap: 0.3, ..DataConfig::default() };
    let sampler = sampler_of(EllipsoidViews::new(12, 1), &data, &model());
    for index in 0..10 {
        let sample = sampler.sample(index, false).unwrap();
        let truth = &sample.t_query_reference;
        assert!(truth.rotation_angle_deg(&Pose::identity()) <= 70.0);
        assert!(overlap_share(&sample.query.points, &sample.reference.cloud.points, truth, 0.16) >= 0.3);
    }
}

#[test]
fn a_dataset_without_pairs_is_refused() {
    let build = |data: DataConfig, images| {
        PairSampler::new(Arc::new(EllipsoidViews::new(images, 1)), &data, &model(), 0)
    };
    assert!(matches!(build(DataConfig::default(), 1), Err(DataError::NoPairs)));
    let data = DataConfig { min_visible_pixels: 1_000_000, ..DataConfig::default() };
    assert!(matches!(build(data, 3), Err(DataError::NoPairs)));
}

#[test]
fn instances_below_the_configured_size_are_neither_query_nor_reference() {
    // Two of six images of 320 x 240 show object 1 with 100 visible pixels, by their index.
    let drawn = |min_visible_pixels| {
        let mut views = EllipsoidViews::new(6, 1);
        for instance in views.instances.iter_mut().filter(|i| i.obj_id == 1 && i.image < 2) {
            instance.px_count_visib = 100;
        }
        let data = DataConfig { min_visible_pixels, ..DataConfig::default() };
        let sampler = sampler_of(views, &data, &model());
        let keys = (0..60).map(|i| sampler.sample(i, false).unwrap().key);
        keys.filter(|k| k.obj_id == 1 && k.query_image.min(k.reference_image) < 2).count()
    };
    assert_eq!(drawn(128), 0);
    assert!(drawn(64) > 5, "{}", drawn(64));
}

#[test]
fn bad_views_are_named() {
    let views = EllipsoidViews::new(1, 1);
    let (frame, mask) = (&views.frames[0].frame, &views.frames[0].instances[0].mask_visib);
    let rng = || ChaCha8Rng::seed_from_u64(0);
    let reference = |frame: &RgbdFrame, mask: &Mask| {
        prepare_reference(frame, mask, &model(), &mut rng()).map(|r| r.radius)
    };
    let message = |result: Result<f32, DataError>| result.unwrap_err().to_string();

    assert!(message(reference(frame, &Mask::empty(320, 240))).contains("mask is empty"));
    let error = message(reference(frame, &Mask::empty(240, 320)));
    assert!(error.contains("the mask is 240 x 320 pixels, expected 320 x 240"), "{error}");
    let mut few = Mask::empty(320, 240);
    mask.pixels().skip(900).take(6).for_each(|(c, r)| few.data[(r * 320 + c) as usize] = true);
    assert!(matches!(reference(frame, &few), Err(DataError::TooFewPixels { .. })));

    let mut scaled = frame.clone();
    scaled.depth.data.iter_mut().for_each(|d| *d *= 1000.0);
    let error = message(reference(&scaled, mask));
    assert!(error.contains("depth_scale") && error.contains("1000 times too large"), "{error}");
    let mut blind = frame.clone();
    blind.depth.data.fill(f32::NAN);
    assert!(message(reference(&blind, mask)).contains("none with depth"));
    let query = |radius| prepare_query(frame, mask, radius, &model(), &mut rng()).map(|_| radius);
    assert!(matches!(query(f32::NAN), Err(DataError::QueryRadius { .. })));
    assert!(matches!(query(0.002), Err(DataError::TooFewPoints { .. })));
    assert!(query(0.1).is_ok());
}

#[test]
fn structure_does_not_change_with_the_camera() {
    // The corrected frames see the object only: rotating the reference leaves its structure as it was.
    let views = EllipsoidViews::new(1, 3);
    let frame = &views.frames[0];
    let model = model();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let reference =
        prepare_reference(&frame.frame, &frame.instances[0].mask_visib, &model, &mut rng).unwrap();
    let scale = reference.radius;
    let turn = Pose::new(*nalgebra::Rotation3::new(Vector3::new(1.0, 0.4, -0.7)).matrix(), Vector3::zeros());
    assert!((turn.rotation - Matrix3::identity()).norm() > 0.5);
    let cloud = &reference.cloud;
    let prepare = |points: Vec<[f32; 3]>| {
        let points: Vec<[f32; 3]> = points.iter().map(|p| p.map(|v| v * scale)).collect();
        unopose_pairs::data::query_from_points(&points, &cloud.choose, vec![], scale, &model)
    };
    let plain = prepare(cloud.points.clone());
    let turned = prepare(cloud.points.iter().map(|p| turn.transform_f32(p)).collect());
    // Farthest point sampling may pick other points on near-ties; compare while the picks agree.
    assert_eq!(plain.sparse[..8], turned.sparse[..8]);
    if plain.sparse == turned.sparse {
        let worst = plain.structure.distances.iter().zip(&turned.structure.distances);
        let worst = worst.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-2, "{worst}");
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn pairs_of_published_shards_align() {
    let folder = unopose_tests::shared("bench/megapose_example");
    let dataset = Arc::new(ShardDataset::open(&folder).unwrap());
    let data = DataConfig { min_overlap: 0.3, ..DataConfig::default() };
    // Without the limit one stray pixel makes the radius of object 3 0.25 m instead of 0.08 m.
    let model = ModelConfig { reference_reach: 3.0, ..model() };
    let sampler = PairSampler::new(dataset, &data, &model, 3).unwrap();
    for index in 0..8 {
        let sample = sampler.sample(index, true).unwrap();
        let (query, reference) = (&sample.query.points, &sample.reference.cloud.points);
        // Of the points that overlap within the loss' distance most lie within the spacing of the points.
        let share = |within| overlap_share(query, reference, &sample.t_query_reference, within);
        assert!(share(0.15) > 0.25 && share(0.1) > 0.6 * share(0.15), "{} {}", share(0.1), share(0.15));
        assert!((0.05..0.15).contains(&sample.reference.radius), "{}", sample.reference.radius);
    }
}
