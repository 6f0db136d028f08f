use std::path::Path;

use unopose_core::{config::SynthConfig, frame::DepthMap};
use unopose_dataset::formats::{
    megapose::{EncodedImage, ImageRecords, ShardDataset, ShardWriter, shard_file_name},
    rle::Rle,
    targets::{read_reference_targets, write_targets},
};

use super::*;
use crate::{generate, generate_bop};

fn config() -> SynthConfig {
    SynthConfig {
        seed: 5,
        images: 4,
        images_per_shard: 2,
        views_per_scene: 2,
        objects: 5,
        width: 200,
        height: 150,
        supersampling: 1,
        texture_size: 32,
        ..SynthConfig::default()
    }
}

fn findings(dir: &Path) -> Vec<String> {
    let report = check_dataset(dir, 1, &|_, _| {}).unwrap();
    report.findings().map(|f| format!("{}: {}", f.place, f.what)).collect()
}

/// Writes shard 1 again with changed images.
fn rewrite(from: &Path, to: &Path, change: impl Fn(usize, &mut String, &mut DepthMap, &mut ImageRecords)) {
    let dataset = ShardDataset::open(from).unwrap();
    let mut writer = ShardWriter::default();
    for (i, image) in (2..4).enumerate() {
        let (mut frame, mut records) = (dataset.load(image).unwrap().frame, dataset.records(image).unwrap());
        let mut key = dataset.image_keys()[image as usize].clone();
        change(i, &mut key, &mut frame.depth, &mut records);
        writer.push(EncodedImage::new(&key, &frame.rgb, 90, &frame.depth, &records).unwrap());
    }
    writer.write(&to.join("train_pbr_web").join(shard_file_name(1))).unwrap();
}

#[test]
fn damage_in_shards_is_found_and_named() {
    let [whole, broken] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    for folder in [&whole, &broken] {
        generate(&config(), folder.path(), &|_| {}).unwrap();
    }
    let report = check_dataset(whole.path(), 1, &|_, _| {}).unwrap();
    assert_eq!(findings(whole.path()), Vec::<String>::new());
    assert_eq!((report.parts.len(), report.images()), (2, 4));
    let statistics = report.statistics();
    assert!(statistics.silhouette_iou.quantile(0.1) > 0.99);
    assert!(statistics.depth_error.quantile(0.5) < 0.003);

    // Every kind of damage has a message of its own.
    let found = |part: &str, change: &dyn Fn(usize, &mut String, &mut DepthMap, &mut ImageRecords)| {
        rewrite(whole.path(), broken.path(), change);
        let all = findings(broken.path());
        assert!(all.iter().any(|f| f.contains(part)), "{part:?} not in {all:#?}");
    };
    found("mask and posed model differ", &|_, _, _, r| {
        r.gt.iter_mut().for_each(|g| g.cam_t_m2c[0] += 30.0);
    });
    found("depth and posed model differ", &|_, _, d, _| d.data.iter_mut().for_each(|z| *z *= 1.1));
    found("expected in millimetres", &|_, _, _, r| {
        r.gt.iter_mut().for_each(|g| g.cam_t_m2c = g.cam_t_m2c.map(|t| t / 1000.0));
    });
    found("a rotation matrix", &|_, _, _, r| r.gt[0].cam_r_m2c[0] += 0.5);
    found("px_count_visib is", &|_, _, _, r| r.gt_info[0].px_count_visib += 1);
    found("visible masks of instances", &|_, _, _, r| r.mask_visib[1] = r.mask_visib[0].clone());
    found("the same key is in shard 0", &|_, key, _, _| {
        *key = format!("000000_{}", key.split('_').next_back().unwrap());
    });
    found("focal lengths are", &|_, _, _, r| r.camera.cam_k[0] *= 100.0);
    found("no pixel has a depth", &|_, _, d, _| d.data.fill(0.0));

    // Depth a thousand times too far does not allow itself an error that grows with it.
    found("median depth in the mask is", &|_, _, d, r| {
        r.camera.depth_scale = Some(100.0);
        d.data.iter_mut().for_each(|z| *z *= 1000.0);
    });
    found("depth_scale is 1e308", &|_, _, _, r| r.camera.depth_scale = Some(1e308));
    found("mask size is 31623 x 31623", &|_, _, _, r| r.mask_visib[0].size = [31_623; 2]);

    let shard = broken.path().join("train_pbr_web").join(shard_file_name(1));
    std::fs::write(&shard, vec![0; 1024]).unwrap();
    let all = findings(broken.path());
    assert!(all.iter().any(|f| f.contains("no images in 1024 bytes")), "{all:#?}");
    std::fs::remove_file(&shard).unwrap();
    let all = findings(broken.path());
    for part in
        ["1 of 2 shards missing: 1", "instances are not in the shards", "do not agree with the shards"]
    {
        assert!(all.iter().any(|f| f.contains(part)), "{part:?} not in {all:#?}");
    }
}

#[test]
fn inverted_masks_are_counted_and_everything_else_still_checked() {
    let [whole, broken] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    for folder in [&whole, &broken] {
        generate(&config(), folder.path(), &|_| {}).unwrap();
    }
    let invert = |rle: &mut Rle| {
        let mut mask = rle.decode().unwrap();
        mask.data.iter_mut().for_each(|set| *set = !*set);
        *rle = Rle::encode(&mask);
    };
    rewrite(whole.path(), broken.path(), |_, _, _, r| {
        r.mask.iter_mut().chain(&mut r.mask_visib).for_each(invert);
    });
    let report = check_dataset(broken.path(), 1, &|_, _| {}).unwrap();
    let instances = report.parts[1].instances;
    assert!(instances >= 2);
    assert_eq!((report.mended_masks(), report.skipped_instances()), (instances, 0));
    let others: Vec<_> = report.findings().filter(|f| !f.what.contains("visible mask is inverted")).collect();
    assert!(others.is_empty(), "{others:?}");
    // Neither mask nor complement has the recorded pixels: nothing is known of these instances but their poses.
    rewrite(whole.path(), broken.path(), |_, _, _, r| {
        r.mask_visib.iter_mut().for_each(invert);
        r.gt_info.iter_mut().for_each(|info| info.px_count_visib = 5000);
    });
    let report = check_dataset(broken.path(), 1, &|_, _| {}).unwrap();
    assert_eq!((report.mended_masks(), report.skipped_instances()), (0, instances));
}

#[test]
fn a_shard_of_the_largest_number_is_no_set_of_four_billion() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("shard-4294967295.tar"), vec![0; 1024]).unwrap();
    let all = findings(folder.path());
    assert!(
        all.iter().any(|f| f.contains("4294967295 of 4294967296 shards missing: 0, 1, 2, 3, 4 ...")),
        "{all:#?}"
    );
}

#[test]
fn damage_in_scenes_and_lists_is_found_and_named() {
    let folder = tempfile::tempdir().unwrap();
    generate_bop(&SynthConfig { images: 12, ..config() }, folder.path(), &|_| {}).unwrap();
    assert_eq!(findings(folder.path()), Vec::<String>::new());
    let list = folder.path().join("test_ref_targets_crossscene_rot50.json");
    let mut references = read_reference_targets(&list).unwrap();
    references[0].ref_im_id = 99;
    write_targets(&list, &references).unwrap();
    let scene = folder.path().join("test/000002");
    std::fs::remove_file(scene.join("mask_visib/000001_000000.png")).unwrap();
    let cameras = folder.path().join("test/000001/scene_camera.json");
    let text = std::fs::read_to_string(&cameras).unwrap();
    let thousandfold = text.replace("\"depth_scale\":0.1", "\"depth_scale\":100.0");
    assert_ne!(thousandfold, text);
    std::fs::write(&cameras, thousandfold).unwrap();
    std::fs::copy(scene.join("rgb/000000.png"), scene.join("rgb/000007.png")).unwrap();
    let all = findings(folder.path());
    for part in [
        "1 references are not annotated",
        "mask_visib/000001_000000.png",
        "1 pictures are not in",
        "depth and posed model differ by ",
    ] {
        assert!(all.iter().any(|f| f.contains(part)), "{part:?} not in {all:#?}");
    }
    let empty = tempfile::tempdir().unwrap();
    assert!(check_dataset(empty.path(), 1, &|_, _| {}).unwrap_err().to_string().contains("neither shards"));
}
