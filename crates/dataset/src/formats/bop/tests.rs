use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};

use super::*;

fn write_scene(root: &Path) -> SceneImage {
    let mut mask = Mask::empty(16, 12);
    (20..40).for_each(|i| mask.data[i] = true);
    let mut mask_visib = mask.clone();
    mask_visib.data[20] = false;
    let mut depth = DepthMap::zeros(16, 12);
    depth.data[..30].fill(0.75);
    let image = SceneImage {
        im_id: 7,
        frame: RgbdFrame {
            rgb: image::RgbImage::from_pixel(16, 12, image::Rgb([9, 80, 200])),
            depth,
            intrinsics: Intrinsics { fx: 600.0, fy: 601.0, cx: 7.5, cy: 5.5 },
        },
        instances: vec![SceneInstance {
            obj_id: 3,
            t_camera_object: Pose::new(
                Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
                Vector3::new(0.01, -0.02, 0.75),
            ),
            mask,
            mask_visib,
            px_count_all: 25,
        }],
    };
    let mut writer = BopSceneWriter::new(&root.join("test_primesense"), 2, 0.1, false);
    writer.add(&image).unwrap();
    writer.finish().unwrap();
    image
}

#[test]
fn a_written_scene_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let written = write_scene(folder.path());
    let dataset = BopDataset::open(folder.path()).unwrap();
    assert_eq!(dataset.splits().unwrap(), ["test_primesense"]);
    let split = dataset.test_split().unwrap();
    assert_eq!((split.name().as_str(), split.scene_ids()), ("test_primesense", [2].as_slice()));
    let read = split.load(2, 7).unwrap();
    let (instance, expected) = (&read.instances[0], &written.instances[0]);
    assert_eq!(read.frame.rgb, written.frame.rgb);
    assert_eq!(read.frame.depth, written.frame.depth);
    assert_eq!(read.frame.intrinsics, written.frame.intrinsics);
    assert_eq!(instance.mask_visib, expected.mask_visib);
    assert_eq!((instance.obj_id, instance.px_count_visib, instance.visib_fract), (3, 19, 19.0 / 25.0));
    assert!(instance.t_camera_object.translation_distance(&expected.t_camera_object) < 1e-12);
    let scene = split.scene(2).unwrap();
    let info = &scene.gt_info(7).unwrap()[0];
    assert_eq!((info.bbox_obj, info.px_count_valid), ([0, 1, 15, 1], 10));
}

#[test]
fn a_scale_that_the_scene_lacks_is_the_datasets() {
    let folder = tempfile::tempdir().unwrap();
    let written = write_scene(folder.path());
    let cameras = folder.path().join("test_primesense/000002/scene_camera.json");
    let with_scale = std::fs::read_to_string(&cameras).unwrap();
    let depth = || {
        let dataset = BopDataset::open(folder.path()).unwrap();
        dataset.test_split().unwrap().scene(2).unwrap().depth(7).map(|depth| depth.data[0])
    };
    std::fs::write(&cameras, with_scale.replace("\"depth_scale\":0.1", "\"other\":0.1")).unwrap();
    // BOP's default: a tenth of a millimetre is taken for a whole one.
    assert!((depth().unwrap() - 7.5).abs() < 1e-6);
    let camera = folder.path().join("camera.json");
    let fields = r#"{"fx": 600.0, "fy": 601.0, "cx": 7.5, "cy": 5.5"#;
    std::fs::write(&camera, format!("{fields}, \"depth_scale\": 0.1}}")).unwrap();
    assert_eq!(depth().unwrap(), written.frame.depth.data[0]);
    // A size that contradicts the image.
    std::fs::write(&cameras, with_scale.replace("\"depth_scale\"", "\"width\":32,\"depth_scale\"")).unwrap();
    let message =
        BopDataset::open(folder.path()).unwrap().test_split().unwrap().load(2, 7).unwrap_err().to_string();
    assert!(message.contains("32 x 12") && message.contains("16 x 12"), "{message}");
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let dataset = BopDataset::open(folder.path()).unwrap();
    let scene_folder = folder.path().join("test_primesense/000002");
    let fails = |part: &str| {
        let message = dataset.test_split().and_then(|s| s.load(2, 7)).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    };
    assert!(dataset.split("train").unwrap_err().to_string().contains("splits found: test_primesense"));
    assert!(dataset.test_split().unwrap().load(2, 8).unwrap_err().to_string().contains("000008"));
    assert!(dataset.test_split().unwrap().load(9, 8).unwrap_err().to_string().contains("scene 9 not found"));
    assert!(dataset.models_info().unwrap_err().to_string().contains("models_info.json not found"));

    let small = image::GrayImage::new(4, 4);
    small.save(scene_folder.join("mask_visib/000007_000000.png")).unwrap();
    fails("mask size is 4 x 4");
    std::fs::remove_file(scene_folder.join("mask_visib/000007_000000.png")).unwrap();
    fails("mask_visib/000007_000000.png");
    std::fs::rename(scene_folder.join("rgb"), scene_folder.join("rbg")).unwrap();
    fails("rgb|gray/000007");
    std::fs::write(scene_folder.join("scene_camera.json"), r#"{"7": {"cam_K": [0,0,0,0,0,0,0,0,1]}}"#)
        .unwrap();
    std::fs::rename(scene_folder.join("rbg"), scene_folder.join("rgb")).unwrap();
    fails("image 7: cam_K focal length fx is 0");
    std::fs::remove_file(scene_folder.join("scene_camera.json")).unwrap();
    assert!(dataset.test_split().unwrap_err().to_string().contains("split test or val not found"));
}

/// ITODD and MVTec style: `gray/*.tif` with `depth/*.tif`; HB: a `test` split without annotations beside an annotated `val`.
#[test]
fn gray_tif_depth_tif_jpeg_and_unannotated_splits_are_read() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path());
    let scene = folder.path().join("test_primesense/000002");
    image::open(scene.join("rgb/000007.png")).unwrap().into_luma8().save(scene.join("rgb/gray.tif")).unwrap();
    image::open(scene.join("depth/000007.png"))
        .unwrap()
        .into_luma16()
        .save(scene.join("depth/000007.tif"))
        .unwrap();
    std::fs::remove_file(scene.join("depth/000007.png")).unwrap();
    std::fs::create_dir(scene.join("gray")).unwrap();
    std::fs::rename(scene.join("rgb/gray.tif"), scene.join("gray/000007.tif")).unwrap();
    let colour = scene.join("rgb/000007.png");
    let jpeg = image::open(&colour).unwrap().into_rgb8();
    std::fs::remove_file(&colour).unwrap();
    let dataset = BopDataset::open(folder.path()).unwrap();
    let frame = dataset.test_split().unwrap().load(2, 7).unwrap().frame;
    // 0.299, 0.587 and 0.114 of 9, 80 and 200, or 0.2126, 0.7152 and 0.0722.
    let gray = frame.rgb.get_pixel(3, 3).0;
    assert!(gray[0] == gray[1] && (70..=75).contains(&gray[0]), "{gray:?}");
    assert_eq!((frame.depth.data[3], frame.depth.data[50]), (0.75, 0.0));
    assert_eq!(dataset.test_split().unwrap().scene(2).unwrap().image_size(7).unwrap(), (16, 12));
    crate::formats::image_io::write_rgb(&scene.join("rgb/000007.jpg"), &jpeg).unwrap();
    let blue = dataset.test_split().unwrap().load(2, 7).unwrap().frame.rgb.get_pixel(3, 3).0;
    assert!(blue[2] > 190 && blue[0] < 20, "{blue:?}");

    assert!(dataset.test_split().unwrap().is_annotated());
    let unannotated = folder.path().join("test/000002");
    std::fs::create_dir_all(&unannotated).unwrap();
    std::fs::copy(scene.join("scene_camera.json"), unannotated.join("scene_camera.json")).unwrap();
    assert_eq!(dataset.test_split().unwrap().name(), "test_primesense");
    assert_eq!(dataset.reference_split_name(), None);
    let tudl = folder.path().join("TUD-L");
    std::fs::create_dir_all(tudl.join("train_real")).unwrap();
    assert_eq!(BopDataset::open(&tudl).unwrap().reference_split_name(), Some("train_real"));
}
