//! Shards with damage: what can be used is used, what cannot is named and counted.

use std::path::Path;

use unopose_core::{
    frame::{DepthMap, Mask},
    geometry::Pose,
};

use super::{
    tests::{encoded_with, write_shard},
    *,
};
use crate::formats::{
    bop::GtRecord,
    rle::{Counts, Rle},
};

const KEY: &str = "000000_000000";
/// Pixels of the object's mask; the image has 1200.
const PIXELS: u32 = 110;

/// A set of one image, changed.
fn set_of(change: impl Fn(&mut ImageRecords, &mut DepthMap)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::default();
    writer.push(encoded_with(KEY, |records, depth| {
        object_in_the_middle(records);
        change(records, depth);
    }));
    writer.write(&folder.path().join(shard_file_name(0))).unwrap();
    folder
}

fn object_in_the_middle(records: &mut ImageRecords) {
    let mut mask = Mask::empty(40, 30);
    for (col, row) in (10..20).flat_map(|row| (14..25).map(move |col| (col, row))) {
        mask.data[row * 40 + col] = true;
    }
    (records.mask, records.mask_visib) = (vec![Rle::encode(&mask)], vec![Rle::encode(&mask)]);
    records.gt = vec![GtRecord::new(7, &Pose { translation: [0.0, 0.0, 0.8].into(), ..Pose::identity() })];
    (records.gt_info[0].px_count_visib, records.gt_info[0].px_count_all) = (PIXELS, PIXELS);
}

fn invert_masks(records: &mut ImageRecords) {
    for rle in records.mask.iter_mut().chain(&mut records.mask_visib) {
        let mut mask = rle.decode().unwrap();
        mask.data.iter_mut().for_each(|set| *set = !*set);
        *rle = Rle::encode(&mask);
    }
}

/// Visible pixels after loading, masks mended and instances skipped.
fn loaded(folder: &Path) -> (usize, usize, usize) {
    let dataset = ShardDataset::open(folder).unwrap();
    // What is loaded twice counts once.
    dataset.load(0).unwrap();
    let pixels = dataset.load(0).unwrap().instances[0].mask_visib.count();
    (pixels, dataset.faults().mended_masks, dataset.faults().skipped_instances)
}

#[test]
fn inverted_masks_are_mended_or_skipped() {
    let whole = PIXELS as usize;
    assert_eq!(loaded(set_of(|_, _| {}).path()), (whole, 0, 0));
    // Two pixels of difference are no matter.
    assert_eq!(loaded(set_of(|r, _| r.gt_info[0].px_count_visib -= 2).path()), (whole, 0, 0));
    assert_eq!(loaded(set_of(|r, _| invert_masks(r)).path()), (whole, 1, 0));
    let neither = set_of(|r, _| {
        invert_masks(r);
        r.gt_info[0].px_count_visib = 500;
    });
    assert_eq!(loaded(neither.path()), (0, 0, 1));
    // The number was taken from the inverted mask.
    let counted = set_of(|r, _| {
        invert_masks(r);
        r.gt_info[0].px_count_visib = 1200 - PIXELS;
    });
    assert_eq!(loaded(counted.path()), (0, 0, 1));
    let model = r#"{"7": {"diameter": 170, "min_x": -50, "min_y": -50, "min_z": -50, "size_x": 100, "size_y": 100,
        "size_z": 100}}"#;
    std::fs::write(counted.path().join("models_info.json"), model).unwrap();
    assert_eq!(loaded(counted.path()), (whole, 1, 0));
    // An object that fills the image.
    let near = set_of(|r, _| {
        r.mask_visib[0] = Rle { size: [30, 40], counts: Counts::Runs(vec![0, 1200]) };
        r.gt_info[0].px_count_visib = 1200;
    });
    assert_eq!(loaded(near.path()), (1200, 0, 0));
}

#[test]
fn a_shard_by_itself_tells_what_was_mended() {
    let folder = set_of(|r, _| invert_masks(r));
    let (_, shards) = ShardFile::list(folder.path());
    let image = ShardFile::open(0, &shards[0].1).unwrap().read(KEY, &Default::default()).unwrap();
    assert_eq!(image.masks[0], image.annotated.instances[0].mask_visib);
    let [(0, fault)] = image.faults.as_slice() else { panic!("{:?}", image.faults) };
    let text = fault.to_string();
    assert!(
        text.contains("inverted: it has 1090 pixels and 110 are outside it, px_count_visib is 110"),
        "{text}"
    );
}

#[test]
fn depth_in_another_unit_is_skipped() {
    // Two metres behind the pose.
    assert_eq!(loaded(set_of(|_, depth| depth.data.fill(2.9)).path()), (0, 0, 1));
    assert_eq!(loaded(set_of(|_, depth| depth.data.fill(1.2)).path()), (PIXELS as usize, 0, 0));
}

#[test]
fn what_no_camera_and_no_pose_has_is_refused_when_the_set_is_opened() {
    type Change = fn(&mut ImageRecords);
    let cases: [(Change, &str); 4] = [
        (|r| r.camera.depth_scale = Some(1e308), "depth_scale is 1e308, expected 0.002 to 1000"),
        (|r| r.camera.depth_scale = None, "depth_scale not found"),
        (|r| r.gt[0].cam_r_m2c = [0.0; 9], "instance 0: cam_R_m2c is [0.0, 0.0"),
        (|r| r.gt_info.clear(), "number of instances is 0, expected 1"),
    ];
    for (change, part) in cases {
        let error = ShardDataset::open(set_of(|r, _| change(r)).path()).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains(KEY) && error.contains("shard-000000.tar"), "{error}");
    }
    // In metres.
    let near = set_of(|r, _| r.gt[0].cam_t_m2c = [0.0, 0.0, 0.8]);
    let dataset = ShardDataset::open(near.path()).unwrap();
    assert!(dataset.instances().is_empty());
    let problem = &dataset.problems()[0];
    assert!(problem.contains("1 visible instances skipped") && problem.contains("millimetres"), "{problem}");
}

#[test]
fn a_mask_of_a_billion_pixels_is_not_decoded() {
    let huge = Rle { size: [31_623, 31_623], counts: Counts::Runs(vec![31_623 * 31_623]) };
    let folder = set_of(move |r, _| r.mask_visib[0] = huge.clone());
    let dataset = ShardDataset::open(folder.path()).unwrap();
    for _ in 0..2 {
        let error = dataset.load(0).unwrap_err().to_string();
        assert!(error.contains(KEY) && error.contains("mask size is 31623 x 31623"), "{error}");
    }
    assert_eq!(dataset.faults().unreadable_images, 1);
}

/// Sets the size in the header at `offset` and makes its checksum right.
fn set_size(bytes: &mut [u8], offset: usize, size: &[u8; 12]) {
    let mut header = tar::Header::new_ustar();
    header.as_mut_bytes().copy_from_slice(&bytes[offset..offset + 512]);
    header.as_mut_bytes()[124..136].copy_from_slice(size);
    header.set_cksum();
    bytes[offset..offset + 512].copy_from_slice(header.as_bytes());
}

#[test]
fn absurd_sizes_in_headers_end_a_shard_after_its_whole_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_shard(folder.path(), 0, 2);
    let good = std::fs::read(&path).unwrap();
    let second = (0..good.len() / 512).find(|i| good[512 * i..].starts_with(b"000000_000001.camera.json"));
    let mut largest = [0xff; 12];
    largest[0] = 0x80;
    let mut last_blocks = [0xff; 12];
    last_blocks[..5].copy_from_slice(&[0x80, 0, 0, 0, 0]);
    for size in [b"77777777777\0", &largest, &last_blocks] {
        let mut bytes = good.clone();
        set_size(&mut bytes, 512 * second.unwrap(), size);
        std::fs::write(&path, bytes).unwrap();
        let dataset = ShardDataset::open(folder.path()).unwrap();
        assert_eq!(dataset.image_keys(), [KEY]);
        dataset.load(0).unwrap();
        assert!(dataset.problems()[0].contains("shard-000000.tar: "), "{:?}", dataset.problems());
    }
}

#[test]
fn keys_and_members_that_occur_twice_and_lists_of_absent_images_are_named() {
    let folder = set_of(|_, _| {});
    let root = folder.path();
    let (first, second) = (root.join(shard_file_name(0)), root.join(shard_file_name(1)));
    std::fs::copy(&first, &second).unwrap();
    std::fs::write(
        root.join("megapose_gso_fixed_valid_inst_ids.json"),
        r#"{"000000/000000_000000": [0], "000009/000009_000000": [0]}"#,
    )
    .unwrap();
    let dataset = ShardDataset::open(root).unwrap();
    assert_eq!(dataset.image_keys().len(), 1);
    let problems = dataset.problems().join("\n");
    for part in
        ["shard-000001.tar: 000000_000000 is in another shard", "1 of the 2 images in the index files"]
    {
        assert!(problems.contains(part), "{problems}");
    }
    // The same members again behind the first ones.
    let bytes = std::fs::read(&first).unwrap();
    let end = bytes.len() - 1024;
    std::fs::write(&second, [&bytes[..end], &bytes].concat()).unwrap();
    std::fs::remove_file(&first).unwrap();
    let dataset = ShardDataset::open(root).unwrap();
    dataset.load(0).unwrap();
    assert!(dataset.problems()[0].contains("000000_000000.camera.json is there twice"));
    std::fs::write(root.join("megapose_gso_fixed_valid_inst_ids.json"), r#"{"000000/0"#).unwrap();
    let error = ShardDataset::open(root).unwrap_err().to_string();
    assert!(error.contains("megapose_gso_fixed_valid_inst_ids.json: EOF"), "{error}");
}

/// Bytes flipped, runs overwritten and ends cut off, anywhere in a shard.
#[test]
fn no_damage_ends_the_reading() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_shard(folder.path(), 0, 2);
    let good = std::fs::read(&path).unwrap();
    let mut state = 1u64;
    let mut draw = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let (mut whole, mut unreadable) = (0, 0);
    for _ in 0..4000 {
        let mut bytes = good.clone();
        for _ in 0..1 + draw(3) {
            let at = draw(bytes.len());
            match draw(8) {
                0 => bytes.truncate(at + 1),
                1 => bytes[at..].iter_mut().take(16).for_each(|b| *b = 0xff),
                2 => bytes[at] = draw(256) as u8,
                _ => bytes[at] ^= 1 << draw(8),
            }
        }
        std::fs::write(&path, bytes).unwrap();
        let Ok(dataset) = ShardDataset::open(folder.path()) else { continue };
        for image in 0..dataset.image_keys().len() as u32 {
            match dataset.load(image) {
                Ok(_) => whole += 1,
                Err(error) => {
                    unreadable += 1;
                    assert!(error.to_string().contains("shard-000000.tar"), "{error}");
                }
            }
        }
        assert!(dataset.faults().unreadable_images <= 2);
    }
    // Most damage leaves the other image whole, and some is found only when the image is decoded.
    assert!(whole > 2500 && unreadable > 200, "{whole} whole, {unreadable} unreadable");
}
