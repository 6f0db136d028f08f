//! The readers on the benchmark's own files, on shards of the BOP toolkit's converters and on real RGB-D frames.

use std::collections::BTreeMap;

use unopose_dataset::{
    formats::{
        BopDataset,
        camera::read_camera,
        files::read_json,
        image_io::{read_depth, read_mask, read_rgb},
        megapose::{ShardDataset, write_index_files},
        targets::{read_reference_targets, read_targets},
    },
    mesh,
};
use unopose_tests::shared;

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn models_have_the_diameters_and_boxes_of_their_list() {
    let root = shared("bench/dev");
    let dataset = BopDataset::open(&root).unwrap();
    let infos = dataset.models_info().unwrap();
    assert_eq!(infos.len(), 10);
    for (id, info) in infos {
        let eval = mesh::load(&dataset.eval_model_path(id).unwrap(), 1e-3).unwrap();
        let diameter = f64::from(eval.diameter());
        assert!((diameter - info.diameter).abs() < 1e-6, "object {id}: {diameter} {}", info.diameter);
        let size = eval.bounds().size();
        assert!((0..3).all(|i| (f64::from(size[i]) - info.size[i]).abs() < 1e-6), "object {id}: {size:?}");
        let textured = mesh::load(&root.join(format!("models/obj_{id:06}.ply")), 1e-3).unwrap();
        assert_eq!(textured.uvs.len(), textured.vertices.len());
        assert!(textured.texture.is_some_and(|t| t.width() >= 256), "object {id}");
    }
    assert!(dataset.models_info().unwrap()[&2].symmetries.continuous.len() == 1);
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn images_agree_with_their_annotation() {
    let root = shared("bench/dev");
    let dataset = BopDataset::open(&root).unwrap();
    assert_eq!(dataset.splits().unwrap(), ["test"]);
    let split = dataset.test_split().unwrap();
    assert_eq!(split.scene_ids().len(), 15);
    for &scene_id in split.scene_ids() {
        let scene = split.scene(scene_id).unwrap();
        let im_id = scene.image_ids().next().unwrap();
        let image = split.load(scene_id, im_id).unwrap();
        assert_eq!((image.frame.width(), image.frame.height()), (640, 480));
        for (instance, info) in image.instances.iter().zip(scene.gt_info(im_id).unwrap()) {
            let bounds = instance.mask_visib.bounding_box();
            assert_eq!(instance.mask_visib.count(), instance.px_count_visib as usize);
            let Some(b) = bounds else { continue };
            let width = (b.col_max - b.col_min - 1) as i32;
            assert_eq!((info.bbox_visib[0], info.bbox_visib[2]), (b.col_min as i32, width));
            // The surface is seen about where the pose says, within the object's radius.
            let depths: Vec<f32> =
                instance.mask_visib.pixels().map(|(c, r)| image.frame.depth.get(c, r)).collect();
            let mut measured: Vec<f32> = depths.into_iter().filter(|&z| z > 0.0).collect();
            measured.sort_by(f32::total_cmp);
            if let Some(median) = measured.get(measured.len() / 2) {
                let distance = (f64::from(*median) - instance.t_camera_object.translation.z).abs();
                assert!(
                    distance < 0.12,
                    "scene {scene_id} image {im_id} object {}: {distance}",
                    instance.obj_id
                );
            }
        }
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn target_lists_agree() {
    let root = shared("bench/dev");
    let targets = read_targets(&root.join("test_targets_bop19.json")).unwrap();
    let path = root.join("test_ref_targets_crossscene_rot50.json");
    assert_eq!(read_targets(&path).unwrap(), targets);
    assert_eq!(targets.len(), 406);
    let references = read_reference_targets(&path).unwrap();
    // The angles of the list are those of the annotated poses.
    let dataset = BopDataset::open(&root).unwrap();
    let (split, infos) = (dataset.test_split().unwrap(), dataset.models_info().unwrap());
    for target in references.iter().step_by(5) {
        let pose = |scene, image| split.scene(scene).unwrap().most_visible(image, target.obj_id).unwrap().1;
        let (a, b) = (pose(target.scene_id, target.im_id), pose(target.ref_scene_id, target.ref_im_id));
        let angle = infos[&target.obj_id].symmetries.rotation_distance_deg(&a, &b);
        // The list samples continuous symmetries every 1.14 degrees.
        assert!((angle - target.rot_deg.unwrap()).abs() < 0.7, "{target:?}: {angle}");
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn the_example_shards_are_read() {
    let folder = shared("bench/megapose_example");
    let dataset = ShardDataset::open(&folder).unwrap();
    let mut keys = dataset.image_keys().to_vec();
    keys.sort();
    assert_eq!(keys, ["000101_000001", "000101_000002", "000102_000000", "000102_000001"]);
    let image = dataset.image_keys().iter().position(|k| k == "000101_000001").unwrap() as u32;
    let frame = dataset.load(image).unwrap();
    let ids: Vec<u32> = frame.instances.iter().map(|i| i.obj_id).collect();
    assert_eq!(ids, [5, 7, 1, 10]);
    for instance in &frame.instances {
        assert_eq!(instance.mask_visib.count(), instance.px_count_visib as usize);
    }
    assert!((frame.instances[0].t_camera_object.translation.z - 0.764_723_405_726_574_5).abs() < 1e-12);
    let valid =
        frame.instances[0].mask_visib.pixels().filter(|&(c, r)| frame.frame.depth.get(c, r) > 0.0).count();
    assert_eq!(valid, 2697, "px_count_valid of the example");
}

/// `key_to_shard.json` of the example, made again from its shards.
#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn the_keys_of_the_example_lie_in_the_published_shards() {
    let published = shared("bench/megapose_example/train_pbr_web");
    let copy = tempfile::tempdir().unwrap();
    for shard in ["shard-000000.tar", "shard-000001.tar"] {
        std::fs::copy(published.join(shard), copy.path().join(shard)).unwrap();
    }
    write_index_files(copy.path(), "example", &ShardDataset::open(copy.path()).unwrap(), [640, 480]).unwrap();
    let shard_of_key = |folder: &std::path::Path| -> BTreeMap<String, u32> {
        read_json(&folder.join("key_to_shard.json")).unwrap()
    };
    assert_eq!(shard_of_key(copy.path()), shard_of_key(&published));
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn real_frames_are_read() {
    let root = shared("real/kinect_tabletop");
    let camera = read_camera(&root.join("camera.json")).unwrap();
    assert_eq!((camera.intrinsics.fx, camera.depth_scale), (1066.778, Some(0.1)));
    let depth = read_depth(&root.join("000001-depth.png"), 0.1).unwrap();
    let mask = read_mask(&root.join("000001-mask-soup.png")).unwrap();
    assert_eq!(read_rgb(&root.join("000001-color.png")).unwrap().dimensions(), (depth.width, depth.height));
    let on_can: Vec<f32> = mask.pixels().map(|(c, r)| depth.get(c, r)).filter(|&z| z > 0.0).collect();
    assert!(on_can.len() > 1000 && on_can.iter().all(|z| (0.3..2.0).contains(z)), "{}", on_can.len());

    let root = shared("real/lmo_frame");
    let can = mesh::load(&root.join("obj_000005.ply"), 1e-3).unwrap();
    assert_eq!((can.vertices.len(), can.colors.len()), (22831, 22831));
    assert_eq!(can.colors[0], [197, 187, 184]);
    assert!((0.19..0.21).contains(&can.diameter()), "{}", can.diameter());
}
