//! Samples and readers of files that belong to a set, and of mesh and depth files that take more than a line to make.

use std::path::Path;

use serde_json::json;
use unopose_core::frame::{DepthMap, Mask};
use unopose_dataset::{
    formats::{
        PhoneSequence,
        image_io::{write_depth, write_mask, write_rgb},
        megapose::{EncodedImage, ImageRecords, ShardDataset, ShardWriter, write_index_files},
        rle::Rle,
    },
    mesh,
};

use crate::readers::Outcome;

/// Columns and rows of the images of the samples.
const SIZE: [u32; 2] = [24, 16];
/// Where the shard and the index file lie in a folder.
pub const SHARD: &str = "shards/shard-000000.tar";
pub const INDEX: &str = "megapose_a_fixed_valid_inst_ids.json";
const KEY: &str = "000001_000000";

fn images() -> (image::RgbImage, DepthMap, Mask) {
    let [width, height] = SIZE;
    let mut mask = Mask::empty(width, height);
    (0..mask.data.len()).filter(|i| i % 24 > 6 && i % 24 < 18).for_each(|i| mask.data[i] = true);
    let rgb = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8 * 9, y as u8 * 12, 77]));
    (rgb, DepthMap { width, height, data: vec![0.7; mask.data.len()] }, mask)
}

fn write_shard(path: &Path) -> Outcome {
    let (rgb, depth, mask) = images();
    let (visible, all) = (mask.count(), Rle::encode(&mask));
    let info = json!({ "bbox_obj": [7, 0, 11, 16], "bbox_visib": [7, 0, 11, 16], "px_count_all": visible,
        "px_count_valid": visible, "px_count_visib": visible, "visib_fract": 1.0 });
    let records = ImageRecords {
        camera: serde_json::from_value(
            json!({ "cam_K": [30, 0, 11.5, 0, 30, 7.5, 0, 0, 1], "depth_scale": 0.1 }),
        )?,
        gt: vec![serde_json::from_value(json!({
            "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 720], "obj_id": 1
        }))?],
        gt_info: vec![serde_json::from_value(info)?],
        mask: vec![all.clone()],
        mask_visib: vec![all],
    };
    let mut shard = ShardWriter::default();
    shard.push(EncodedImage::new(KEY, &rgb, 90, &depth, &records)?);
    Ok(shard.write(path)?)
}

pub fn shard() -> Vec<u8> {
    crate::readers::written("shard-000000.tar", write_shard)
}

pub fn index() -> Vec<u8> {
    crate::readers::written(INDEX, |path| {
        let folder = path.parent().unwrap_or(Path::new("."));
        let shards = folder.join("shards");
        std::fs::create_dir_all(&shards)?;
        write_shard(&folder.join(SHARD))?;
        let set = ShardDataset::open(&shards)?;
        Ok(write_index_files(folder, "a", &set, SIZE)?)
    })
}

/// The set of a folder whose shard or index file is mutated.
pub fn shards(folder: &Path) -> Outcome {
    std::fs::create_dir_all(folder.join("shards"))?;
    if !folder.join(SHARD).exists() {
        write_shard(&folder.join(SHARD))?;
    }
    let set = ShardDataset::open(&folder.join("shards"))?;
    for image in 0..set.image_keys().len() as u32 {
        let frame = set.load(image)?.frame;
        assert!(frame.depth.data.iter().all(|z| z.is_finite() && *z >= 0.0), "depth that is none");
    }
    Ok(())
}

pub const POSES: &str = "0 1 0 0 0.1 0 1 0 0.2 0 0 1 0.3 0 0 0 1\n1 0 -1 0 0 1 0 0 0 0 0 1 0 0 0 0 1\n";
pub const METADATA: &str = r#"{"K": [50, 0, 0, 0, 50, 0, 11.5, 7.5, 1], "w": 24, "h": 16}"#;

/// The sequence of a folder whose list of poses or camera is mutated.
pub fn sequence(folder: &Path) -> Outcome {
    let (rgb, depth, mask) = images();
    for (name, content) in [("cam_poses.txt", POSES), ("metadata", METADATA)] {
        if !folder.join(name).exists() {
            std::fs::write(folder.join(name), content)?;
        }
    }
    for id in 0..2 {
        if !folder.join(format!("rgb/{id:05}.png")).exists() {
            write_rgb(&folder.join(format!("rgb/{id:05}.png")), &rgb)?;
            write_depth(&folder.join(format!("depth/{id:05}.png")), &depth, 1.0)?;
            write_mask(&folder.join(format!("masks/{id:05}.png")), &mask)?;
        }
    }
    let sequence = PhoneSequence::open(folder)?;
    let pose = sequence.relative_pose(0, 1)?;
    assert!(pose.translation.iter().all(|x| x.is_finite()), "{pose:?}");
    sequence.load(0)?;
    Ok(())
}

/// A triangle with indices.
pub fn glb() -> Vec<u8> {
    let corners = [[0f32, 0., 0.], [0.1, 0., 0.], [0., 0.1, 0.]];
    let mut buffer: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    buffer.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    let json = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [0.1, 0.1, 0] },
            { "bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR" }
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 36 }, { "buffer": 0, "byteOffset": 36, "byteLength": 6 }
        ],
        "buffers": [{ "byteLength": buffer.len() }]
    });
    let json = json.to_string();
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let total = 12 + 8 + json.len() + 8 + buffer.len();
    let word = |value: usize| (value as u32).to_le_bytes();
    [
        b"glTF".as_slice(),
        &word(2),
        &word(total),
        &word(json.len()),
        b"JSON",
        json.as_bytes(),
        &word(buffer.len()),
        b"BIN\0",
        &buffer,
    ]
    .concat()
}

pub fn glb_file(folder: &Path) -> Outcome {
    mesh::load(&folder.join("mesh.glb"), 0.001)?.validate()?;
    Ok(())
}

/// Depth as floats.
pub fn exr() -> Vec<u8> {
    use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, WritableImage};
    crate::readers::written("depth.exr", |path| {
        let channel = AnyChannel::new("Z", FlatSamples::F32(vec![0.7; 24]));
        let channels = AnyChannels::sort([channel].into_iter().collect());
        Ok(Image::from_channels((6, 4), channels).write().to_file(path)?)
    })
}
