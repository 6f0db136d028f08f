use std::{collections::BTreeMap, path::PathBuf};

use image::RgbImage;
use serde_json::Value;
use unopose_core::{
    frame::{DepthMap, Mask},
    geometry::{Intrinsics, Pose},
};

use super::*;
use crate::formats::{
    bop::{GtInfoRecord, GtRecord},
    camera::CameraRecord,
    rle::Rle,
};

/// Structure (see [`structure`]) of a shard that the BOP toolkit's converters wrote.
const EXAMPLE_STRUCTURE: &str = include_str!("example_structure.json");

fn encoded(key: &str) -> EncodedImage {
    encoded_with(key, |_, _| {})
}

/// An image whose one instance is recorded with this many visible pixels.
fn encoded_of(key: &str, px_count_visib: u32) -> EncodedImage {
    encoded_with(key, |records, _| records.gt_info[0].px_count_visib = px_count_visib)
}

/// An image with changes.
pub(super) fn encoded_with(key: &str, change: impl Fn(&mut ImageRecords, &mut DepthMap)) -> EncodedImage {
    let (width, height) = (40, 30);
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 19.5, cy: 14.5 };
    let mut mask = Mask::empty(width, height);
    mask.data[..600].fill(true);
    let pose = Pose { translation: [0.1, -0.2, 0.8].into(), ..Pose::identity() };
    let info = GtInfoRecord {
        bbox_obj: [0, 0, 39, 14],
        bbox_visib: [0, 0, 39, 14],
        px_count_all: 640,
        px_count_valid: 600,
        px_count_visib: 600,
        visib_fract: 600.0 / 640.0,
    };
    let mut records = ImageRecords {
        camera: CameraRecord {
            cam_r_w2c: Some(pose.rotation_row_major()),
            cam_t_w2c: Some([0.0, 0.0, 900.0]),
            ..CameraRecord::new(&intrinsics, 0.1)
        },
        gt: vec![GtRecord::new(7, &pose)],
        gt_info: vec![info],
        mask: vec![Rle::encode(&mask)],
        mask_visib: vec![Rle::encode(&mask)],
    };
    let mut depth = DepthMap { width, height, data: vec![0.8123; 1200] };
    change(&mut records, &mut depth);
    EncodedImage::new(key, &RgbImage::from_pixel(width, height, image::Rgb([90; 3])), 95, &depth, &records)
        .unwrap()
}

pub(super) fn write_shard(folder: &std::path::Path, number: u32, images: usize) -> PathBuf {
    let path = folder.join(shard_file_name(number));
    let mut writer = ShardWriter::default();
    (0..images).for_each(|i| writer.push(encoded(&format!("{number:06}_{i:06}"))));
    writer.write(&path).unwrap();
    path
}

#[test]
fn what_is_written_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    write_shard(folder.path(), 3, 2);
    let dataset = ShardDataset::open(folder.path()).unwrap();
    assert_eq!(dataset.image_keys(), ["000003_000000", "000003_000001"]);
    assert_eq!(dataset.references(7), [0, 1]);
    assert!(dataset.references(8).is_empty() && dataset.symmetries(7).is_empty());
    let image = dataset.load(1).unwrap();
    let instance = &image.instances[0];
    assert!((instance.t_camera_object.translation.z - 0.8).abs() < 1e-12);
    assert_eq!(instance.mask_visib.count(), 600);
    assert!((image.frame.depth.get(3, 3) - 0.8123).abs() < 1e-6);
    assert!(dataset.load(2).unwrap_err().to_string().contains("image number is 2"));
    write_index_files(folder.path(), "gso", &dataset, [640, 480]).unwrap();
    let indexed = ShardDataset::open(folder.path()).unwrap();
    assert_eq!(indexed.instances(), dataset.instances());
    assert_eq!(indexed.references(7), dataset.references(7));
}

#[test]
fn small_images_index_small_instances_and_without_an_index_nothing_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::default();
    // A quarter of 640 x 480 has a quarter of 512 pixels.
    for (i, pixels) in [600, 512, 200, 128, 127, 1, 0].into_iter().enumerate() {
        writer.push(encoded_of(&format!("000000_{i:06}"), pixels));
    }
    writer.write(&folder.path().join(shard_file_name(0))).unwrap();
    let pixels = |dataset: &ShardDataset| -> Vec<u32> {
        dataset.instances().iter().map(|i| i.px_count_visib).collect()
    };
    let dataset = ShardDataset::open(folder.path()).unwrap();
    assert_eq!(pixels(&dataset), [600, 512, 200, 128, 127, 1]);
    for (size, listed) in [([320, 240], &[600, 512, 200, 128][..]), ([640, 480], &[600, 512])] {
        write_index_files(folder.path(), "gso", &dataset, size).unwrap();
        assert_eq!(pixels(&ShardDataset::open(folder.path()).unwrap()), listed, "{size:?}");
    }
}

#[test]
fn a_truncated_shard_gives_its_whole_images_and_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_shard(folder.path(), 0, 3);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 3 / 5]).unwrap();
    let dataset = ShardDataset::open(folder.path()).unwrap();
    assert_eq!(dataset.image_keys().len(), 1, "{:?}", dataset.problems());
    assert!(dataset.problems().iter().any(|p| p.contains("shard-000000.tar")), "{:?}", dataset.problems());
    std::fs::write(&path, b"x").unwrap();
    let error = ShardDataset::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("usable images not found") && error.contains("shard-000000.tar"), "{error}");
}

#[test]
fn unpacked_shards_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let packed = ShardDataset::open(write_shard(folder.path(), 5, 2).parent().unwrap()).unwrap();
    let loose = tempfile::tempdir().unwrap();
    let tar = std::fs::File::open(folder.path().join(shard_file_name(5))).unwrap();
    tar::Archive::new(tar).unpack(loose.path().join("000005")).unwrap();
    let unpacked = ShardDataset::open(loose.path()).unwrap();
    assert_eq!(unpacked.instances(), packed.instances());
    let (a, b) = (packed.load(1).unwrap(), unpacked.load(1).unwrap());
    assert_eq!((a.frame.depth, a.frame.rgb), (b.frame.depth, b.frame.rgb));
    std::fs::remove_file(loose.path().join("000005/000005_000001.gt_info.json")).unwrap();
    let damaged = ShardDataset::open(loose.path()).unwrap();
    assert_eq!((damaged.image_keys().len(), damaged.problems().len()), (1, 1));
    assert!(
        damaged.problems()[0].contains("000005_000001.gt_info.json not found"),
        "{:?}",
        damaged.problems()
    );
}

/// Keys and types of a JSON value; lists by their first entry, maps with numeric keys by one entry.
fn shape(value: &Value) -> Value {
    match value {
        Value::Object(map) if map.keys().all(|k| k.parse::<u32>().is_ok()) => {
            Value::Object(map.iter().take(1).map(|(_, v)| ("<index>".to_owned(), shape(v))).collect())
        }
        Value::Object(map) => Value::Object(map.iter().map(|(k, v)| (k.clone(), shape(v))).collect()),
        Value::Array(list) => Value::Array(list.iter().take(1).map(shape).collect()),
        Value::Number(number) if number.is_f64() => "real".into(),
        Value::Number(_) => "integer".into(),
        Value::String(_) => "text".into(),
        _ => value.clone(),
    }
}

/// Extension to structure of the first image's members; pictures by their colour type.
fn structure(shard: &std::path::Path) -> BTreeMap<String, Value> {
    let mut tar = tar::Archive::new(std::fs::File::open(shard).unwrap());
    let mut members = BTreeMap::new();
    for entry in tar.entries().unwrap() {
        let mut entry = entry.unwrap();
        let name = entry.path().unwrap().display().to_string();
        let (_, extension) = name.split_once('.').unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
        let value = match serde_json::from_slice::<Value>(&bytes) {
            Ok(json) => shape(&json),
            Err(_) => format!("{:?}", image::load_from_memory(&bytes).unwrap().color()).into(),
        };
        members.entry(extension.to_owned()).or_insert(value);
    }
    members
}

#[test]
fn members_keys_and_types_equal_the_example() {
    let written = tempfile::tempdir().unwrap();
    let ours = structure(&write_shard(written.path(), 0, 1));
    let theirs: BTreeMap<String, Value> = serde_json::from_str(EXAMPLE_STRUCTURE).unwrap();
    assert_eq!(ours, theirs);
}
