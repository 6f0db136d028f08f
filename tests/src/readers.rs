//! Every reader of files with a small sample, for tests that mutate samples and for the fuzz targets in `fuzz/`.

use std::{error::Error, path::Path};

use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use unopose_core::config::Config;
use unopose_dataset::{
    formats::{
        BopSplit,
        camera::read_camera,
        detections::read_detections,
        image_io::{read_depth, read_mask, read_rgb},
        models::read_models_info,
        results::read_results,
        targets::{read_reference_targets, read_targets},
    },
    mesh,
};
use unopose_nn::checkpoint::{OfficialState, TensorFile};

use crate::{
    pytorch_file::{self, Pickled},
    set_readers,
};

pub type Outcome = Result<(), Box<dyn Error>>;

/// A reader and a file that it reads.
pub struct Reader {
    /// As the fuzz target is called.
    pub name: &'static str,
    /// The file's path below the folder.
    pub file: &'static str,
    /// Content that is read without an error.
    pub sample: fn() -> Vec<u8>,
    /// Reads the file of a folder.
    pub read: fn(&Path) -> Outcome,
}

/// All of them.
pub const READERS: [Reader; 28] = [
    Reader { name: "rgb_png", file: "rgb.png", sample: || colour(ImageFormat::Png), read: rgb },
    Reader { name: "rgb_jpeg", file: "rgb.jpg", sample: || colour(ImageFormat::Jpeg), read: rgb },
    Reader { name: "rgb_webp", file: "rgb.webp", sample: || colour(ImageFormat::WebP), read: rgb },
    Reader { name: "depth_png", file: "depth.png", sample: || depth16(ImageFormat::Png), read: depth },
    Reader { name: "depth_tiff", file: "depth.tif", sample: || depth16(ImageFormat::Tiff), read: depth },
    Reader { name: "depth_npy", file: "depth.npy", sample: npy, read: depth },
    Reader { name: "depth_pfm", file: "depth.pfm", sample: pfm, read: depth },
    Reader { name: "depth_exr", file: "depth.exr", sample: set_readers::exr, read: depth },
    Reader { name: "depth_pgm", file: "depth.pgm", sample: pgm, read: depth },
    Reader { name: "mask_png", file: "mask.png", sample: mask_png, read: mask },
    Reader { name: "camera_json", file: "camera.json", sample: || text(CAMERA), read: camera },
    Reader { name: "camera_yaml", file: "camera.yaml", sample: || text(CAMERA_INFO), read: camera },
    Reader { name: "detections", file: "detections.json", sample: || text(DETECTIONS), read: detections },
    Reader { name: "results_csv", file: "results.csv", sample: || text(RESULTS), read: results },
    Reader { name: "targets", file: "targets.json", sample: || text(TARGETS), read: targets },
    Reader { name: "models_info", file: "models_info.json", sample: || text(MODELS_INFO), read: models_info },
    Reader { name: "scene_gt", file: "test/000001/scene_gt.json", sample: || text(SCENE_GT), read: scene },
    Reader { name: "ply", file: "mesh.ply", sample: || text(PLY), read: mesh_file },
    Reader { name: "obj", file: "mesh.obj", sample: || text(OBJ), read: mesh_file },
    Reader { name: "stl", file: "mesh.stl", sample: stl, read: mesh_file },
    Reader { name: "glb", file: "mesh.glb", sample: set_readers::glb, read: set_readers::glb_file },
    Reader { name: "shard", file: set_readers::SHARD, sample: set_readers::shard, read: set_readers::shards },
    Reader { name: "index", file: set_readers::INDEX, sample: set_readers::index, read: set_readers::shards },
    Reader {
        name: "sequence_poses",
        file: "cam_poses.txt",
        sample: || text(set_readers::POSES),
        read: set_readers::sequence,
    },
    Reader {
        name: "sequence_camera",
        file: "metadata",
        sample: || text(set_readers::METADATA),
        read: set_readers::sequence,
    },
    Reader { name: "safetensors", file: "weights.safetensors", sample: safetensors, read: tensors },
    Reader { name: "pytorch", file: "weights.pth", sample: pytorch, read: pickle },
    Reader { name: "config_toml", file: "config.toml", sample: || text(CONFIG), read: config },
];

const CAMERA: &str = r#"{"cam_K": [600.0, 0, 319.5, 0, 600.0, 239.5, 0, 0, 1], "depth_scale": 0.1, "width": 640, "height": 480}"#;
const CAMERA_INFO: &str = "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [600, 0, 320, 0, 600, 240, 0, 0, 1]\n\
                           distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0, 0, 0]\n";
const DETECTIONS: &str = r#"[{"scene_id": 1, "image_id": 2, "category_id": 3, "bbox": [0, 0, 3, 2], "score": 0.5, "time": 1.0,
 "segmentation": {"size": [2, 3], "counts": [0, 3, 3]}}, {"scene_id": 1, "image_id": 2, "category_id": 3, "bbox": [0, 0, 3, 2],
 "score": 0.5, "time": 1.0, "segmentation": {"size": [2, 3], "counts": "033"}}]"#;
const RESULTS: &str = "scene_id,im_id,obj_id,score,R,t,time\n1,2,3,0.5,1 0 0 0 1 0 0 0 1,10.5 -3 700,0.25\n";
const TARGETS: &str = r#"[{"scene_id": 1, "im_id": 2, "obj_id": 3, "ref_scene_id": 4, "ref_im_id": 5, "inst_count": 1, "rot_deg": 12.5}]"#;
const MODELS_INFO: &str = r#"{"1": {"diameter": 102.5, "min_x": -30, "min_y": -30, "min_z": -40, "size_x": 60, "size_y": 60, "size_z": 80,
 "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}}"#;
const SCENE_GT: &str = r#"{"0": [{"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [10, -20, 700], "obj_id": 1}],
 "7": [{"cam_R_m2c": [0, -1, 0, 1, 0, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 650.5], "obj_id": 2}]}"#;
const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                   property list uchar int vertex_indices\nend_header\n0 0 0\n10 0 0\n0 10 0\n0 0 10\n3 0 1 2\n3 0 1 3\n";
const OBJ: &str =
    "v 0 0 0 255 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1 2 4\n";
const CONFIG: &str = "name = \"a\"\n[train]\nsteps = 5000\nlearning_rate = 1e-3\n[model]\nimage_size = 56\n[model.color]\nkind = \"conv\"\n\
                      channels = [8, 16, 32]\nout_dim = 32\n[synth]\nimages = 10\ndiameter = [0.05, 0.2]\n";

fn text(text: &str) -> Vec<u8> {
    text.as_bytes().to_vec()
}

fn encoded(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    // Writing a small image into memory cannot fail; an empty sample would be noticed.
    let _ = image.into().write_to(&mut bytes, format);
    bytes.into_inner()
}

fn colour(format: ImageFormat) -> Vec<u8> {
    encoded(RgbImage::from_fn(24, 16, |x, y| image::Rgb([x as u8 * 9, y as u8 * 12, 77])), format)
}

fn depth16(format: ImageFormat) -> Vec<u8> {
    encoded(image::ImageBuffer::from_fn(24, 16, |x, y| image::Luma([7000u16 + 3 * (x * y) as u16])), format)
}

fn mask_png() -> Vec<u8> {
    encoded(GrayImage::from_fn(24, 16, |x, y| image::Luma([if x > y { 255 } else { 0 }])), ImageFormat::Png)
}

fn npy() -> Vec<u8> {
    let header = format!("{:<117}\n", "{'descr': '<u2', 'fortran_order': False, 'shape': (4, 6), }");
    let length = (header.len() as u16).to_le_bytes();
    let values = (0..24u16).flat_map(|v| (7000 + v).to_le_bytes());
    [b"\x93NUMPY\x01\x00".as_slice(), &length, header.as_bytes()].concat().into_iter().chain(values).collect()
}

fn pfm() -> Vec<u8> {
    [b"Pf\n6 4\n-1.0\n".as_slice(), &0.7f32.to_le_bytes().repeat(24)].concat()
}

fn pgm() -> Vec<u8> {
    [b"P5\n6 4\n65535\n".as_slice(), &7000u16.to_be_bytes().repeat(24)].concat()
}

fn stl() -> Vec<u8> {
    let triangles =
        [[[0f32, 0., 0.], [10., 0., 0.], [0., 10., 0.]], [[0., 0., 0.], [10., 0., 0.], [0., 0., 10.]]];
    let mut bytes = [vec![b' '; 80], (triangles.len() as u32).to_le_bytes().to_vec()].concat();
    for triangle in triangles {
        let numbers = [0f32; 3].into_iter().chain(triangle.into_iter().flatten());
        bytes.extend(numbers.flat_map(f32::to_le_bytes).chain([0, 0]));
    }
    bytes
}

pub(crate) fn written(name: &str, write: impl FnOnce(&Path) -> Outcome) -> Vec<u8> {
    let read = || -> Result<Vec<u8>, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join(name);
        write(&path)?;
        Ok(std::fs::read(path)?)
    };
    read().unwrap_or_default()
}

fn safetensors() -> Vec<u8> {
    written("a.safetensors", |path| {
        let values = burn::tensor::TensorData::new(vec![0.5f32; 12], [3, 4]);
        let tensors = [("w".to_owned(), values)].into();
        Ok(TensorFile { tensors, metadata: [("step".to_owned(), "3".to_owned())].into() }.write(path)?)
    })
}

fn pytorch() -> Vec<u8> {
    written("a.pth", |path| {
        pytorch_file::write(
            path,
            None,
            &[Pickled::f32("geo_embedding.proj_d.weight", &[2, 3], &[0.5; 6])],
            b"",
        );
        Ok(())
    })
}

fn rgb(folder: &Path) -> Outcome {
    let files = ["rgb.png", "rgb.jpg", "rgb.webp"].map(|name| folder.join(name));
    for file in files.iter().filter(|file| file.exists()) {
        read_rgb(file)?;
    }
    Ok(())
}

fn depth(folder: &Path) -> Outcome {
    let names = ["depth.png", "depth.tif", "depth.npy", "depth.pfm", "depth.pgm", "depth.exr"];
    for file in names.map(|name| folder.join(name)).iter().filter(|file| file.exists()) {
        let depth = read_depth(file, 0.1)?;
        assert!(depth.data.iter().all(|z| z.is_finite() && *z >= 0.0), "depth that is none");
    }
    Ok(())
}

fn mask(folder: &Path) -> Outcome {
    read_mask(&folder.join("mask.png"))?;
    Ok(())
}

fn camera(folder: &Path) -> Outcome {
    for file in ["camera.json", "camera.yaml"].map(|name| folder.join(name)).iter().filter(|f| f.exists()) {
        let camera = read_camera(file)?;
        assert!(camera.intrinsics.fx > 0.0 && camera.intrinsics.cx.is_finite(), "{camera:?}");
    }
    Ok(())
}

fn detections(folder: &Path) -> Outcome {
    for detection in read_detections(&folder.join("detections.json"), None)? {
        detection.segmentation.decode()?;
    }
    Ok(())
}

fn results(folder: &Path) -> Outcome {
    for result in read_results(&folder.join("results.csv"))? {
        assert!(result.t_camera_object.translation.iter().all(|x| x.is_finite()), "{result:?}");
    }
    Ok(())
}

fn targets(folder: &Path) -> Outcome {
    let file = folder.join("targets.json");
    read_reference_targets(&file)?;
    read_targets(&file)?;
    Ok(())
}

fn models_info(folder: &Path) -> Outcome {
    read_models_info(&folder.join("models_info.json"))?;
    Ok(())
}

fn scene(folder: &Path) -> Outcome {
    let camera = r#"{"0": {"cam_K": [600, 0, 320, 0, 600, 240, 0, 0, 1], "depth_scale": 1.0}}"#;
    let file = folder.join("test/000001/scene_camera.json");
    if !file.exists() {
        std::fs::write(file, camera)?;
    }
    let scene = BopSplit::open(&folder.join("test"))?.scene(1)?;
    for record in scene.gt(0)? {
        assert!(record.cam_t_m2c.iter().all(|x| x.is_finite()), "{record:?}");
    }
    Ok(())
}

fn mesh_file(folder: &Path) -> Outcome {
    for file in
        ["mesh.ply", "mesh.obj", "mesh.stl"].map(|name| folder.join(name)).iter().filter(|f| f.exists())
    {
        mesh::load(file, 0.001)?.validate()?;
    }
    Ok(())
}

fn tensors(folder: &Path) -> Outcome {
    TensorFile::read(&folder.join("weights.safetensors"))?;
    Ok(())
}

fn pickle(folder: &Path) -> Outcome {
    OfficialState::read(&folder.join("weights.pth"))?;
    Ok(())
}

fn config(folder: &Path) -> Outcome {
    Config::load(&folder.join("config.toml"), &[])?;
    Ok(())
}
