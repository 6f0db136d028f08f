//! Folders as people have them: named otherwise, of several cameras, with broken entries, without visibility.

use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};

use super::*;
use crate::{
    formats::image_io::{write_mask, write_rgb},
    mesh::{TriangleMesh, ply},
};

/// A square of 20 cm at 1 m, 20 x 20 pixels from (22, 22), whose left half is hidden; object 3 in images 0 and 7.
fn write_scene(split: &Path, scene_id: u32) {
    let square = |left: usize| {
        let mut mask = Mask::empty(64, 64);
        (22..42).for_each(|row| mask.data[row * 64 + left..row * 64 + 42].fill(true));
        mask
    };
    let mut depth = DepthMap::zeros(64, 64);
    depth.data[30 * 64..].fill(1.0);
    let mut writer = BopSceneWriter::new(split, scene_id, 0.1, false);
    for im_id in [0, 7] {
        let image = SceneImage {
            im_id,
            frame: RgbdFrame {
                rgb: image::RgbImage::from_pixel(64, 64, image::Rgb([im_id as u8, 80, 200])),
                depth: depth.clone(),
                intrinsics: Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 },
            },
            instances: vec![SceneInstance {
                obj_id: 3,
                t_camera_object: Pose::new(Matrix3::identity(), Vector3::new(0.0, 0.0, 1.0)),
                mask: square(22),
                mask_visib: square(32),
                px_count_all: 400,
            }],
        };
        writer.add(&image).unwrap();
    }
    writer.finish().unwrap();
}

fn message<T>(result: Result<T, FormatError>) -> String {
    result.err().map(|error| error.to_string()).unwrap_or_default()
}

#[test]
fn folders_of_scenes_may_have_fewer_digits_but_each_number_once() {
    let folder = tempfile::tempdir().unwrap();
    let split = folder.path().join("test");
    write_scene(&split, 1);
    for name in ["1", "01", "0000001"] {
        let from = std::fs::read_dir(&split).unwrap().next().unwrap().unwrap().path();
        std::fs::rename(from, split.join(name)).unwrap();
        let dataset = BopDataset::open(folder.path()).unwrap();
        let read = dataset.test_split().unwrap();
        assert_eq!(read.scene_ids(), [1]);
        assert_eq!(read.scene_folder(1).unwrap(), split.join(name));
        assert_eq!(read.load(1, 7).unwrap().instances[0].obj_id, 3);
        assert!(dataset.split("test").unwrap().is_annotated());
    }
    write_scene(&split, 1);
    let twice = message(BopSplit::open(&split));
    assert!(twice.contains("scene 1 is") && twice.contains("0000001") && twice.contains("000001"), "{twice}");
    for name in ["+2", "-2", "2 ", "99999999999"] {
        std::fs::rename(split.join("000001"), split.join(name)).unwrap();
        assert_eq!(BopSplit::open(&split).unwrap().scene_ids(), [1], "{name}");
        std::fs::rename(split.join(name), split.join("000001")).unwrap();
    }
}

#[test]
fn files_of_images_may_have_fewer_digits() {
    let folder = tempfile::tempdir().unwrap();
    let split = folder.path().join("test");
    write_scene(&split, 1);
    let read = || BopDataset::open(folder.path()).unwrap().test_split().unwrap().load(1, 7).unwrap();
    let written = read();
    for kind in ["rgb", "depth", "mask", "mask_visib"] {
        for entry in std::fs::read_dir(split.join("000001").join(kind)).unwrap() {
            let path = entry.unwrap().path();
            let short = path.file_name().unwrap().to_str().unwrap().replace("0000", "");
            std::fs::rename(&path, path.with_file_name(short)).unwrap();
        }
    }
    assert!(split.join("000001/rgb/07.png").is_file() && split.join("000001/mask/07_00.png").is_file());
    let short = read();
    assert_eq!(short.frame.rgb, written.frame.rgb);
    assert_eq!(short.frame.depth.data, written.frame.depth.data);
    assert_eq!(short.instances[0].mask_visib.data, written.instances[0].mask_visib.data);
}

/// Gives every file and folder of a scene the name of a sensor.
fn name_sensor(scene: &Path, sensor: &str) {
    for name in
        ["rgb", "depth", "mask", "mask_visib", "scene_camera.json", "scene_gt.json", "scene_gt_info.json"]
    {
        let named = match name.strip_suffix(".json") {
            Some(stem) => format!("{stem}_{sensor}.json"),
            None => format!("{name}_{sensor}"),
        };
        std::fs::rename(scene.join(name), scene.join(named)).unwrap();
    }
}

#[test]
fn a_sensor_has_files_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("val/000004");
    write_scene(&folder.path().join("val"), 4);
    name_sensor(&scene, "cam1");
    // The other camera is gray and saw nothing.
    std::fs::write(
        scene.join("scene_camera_photoneo.json"),
        r#"{"0": {"cam_K": [90, 0, 31.5, 0, 90, 31.5, 0, 0, 1]}}"#,
    )
    .unwrap();
    let gray = image::RgbImage::from_pixel(64, 64, image::Rgb([50; 3]));
    write_rgb(&scene.join("gray_photoneo/000000.png"), &gray).unwrap();
    std::fs::create_dir(scene.join("depth_photoneo")).unwrap();
    std::fs::copy(scene.join("depth_cam1/000000.png"), scene.join("depth_photoneo/000000.png")).unwrap();
    std::fs::write(
        folder.path().join("camera_photoneo.json"),
        r#"{"fx": 90, "fy": 90, "cx": 31.5, "cy": 31.5, "depth_scale": 0.2}"#,
    )
    .unwrap();

    let open = |sensor: Option<&str>| {
        BopDataset::open(folder.path()).unwrap().with_sensor(sensor.map(str::to_owned))
    };
    assert_eq!(open(None).splits().unwrap(), ["val"]);
    let none = message(open(None).test_split());
    assert!(
        none.contains("scene_camera.json not found") && none.contains("sensors found: cam1, photoneo"),
        "{none}"
    );
    let other = message(open(Some("cam2")).split("val"));
    assert!(other.contains("sensor cam2 not found (sensors found: cam1, photoneo)"), "{other}");

    let split = open(Some("cam1")).test_split().unwrap();
    let read = split.load(4, 7).unwrap();
    assert_eq!((read.frame.rgb.get_pixel(0, 0).0, read.frame.depth.get(0, 40)), ([7, 80, 200], 1.0));
    assert_eq!((read.instances[0].px_count_visib, read.instances[0].visib_fract), (200, 0.5));
    assert!(split.scene(4).unwrap().gt_file().ends_with("000004/scene_gt_cam1.json"));
    let split = open(Some("photoneo")).test_split().unwrap();
    let read = split.load(4, 0).unwrap();
    // Twice the scale, from the camera file of the sensor.
    assert_eq!((read.frame.rgb.get_pixel(0, 0).0, read.frame.depth.get(0, 40)), ([50; 3], 2.0));
    assert_eq!((read.frame.intrinsics.fx, read.instances.len(), split.is_annotated()), (90.0, 0, false));
    let absent = message(split.load(4, 7));
    assert!(
        absent.contains("scene_camera_photoneo.json: image 7 not found") || absent.contains("gray_photoneo"),
        "{absent}"
    );

    // A scene without this sensor is not of the split; one with a single camera is.
    write_scene(&folder.path().join("val"), 5);
    assert_eq!(open(Some("photoneo")).split("val").unwrap().scene_ids(), [4, 5]);
    name_sensor(&folder.path().join("val/000005"), "cam1");
    assert_eq!(open(Some("photoneo")).split("val").unwrap().scene_ids(), [4]);
    write_scene(&folder.path().join("train"), 6);
    assert_eq!(open(Some("photoneo")).split("train").unwrap().load(6, 0).unwrap().instances.len(), 1);
}

/// Replaces a part of `scene_gt.json`'s entry of image 0 and says what is then wrong with image 0.
fn with_broken(part: &str, by: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), 1);
    let path = folder.path().join("000001/scene_gt.json");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains(part), "{text}");
    std::fs::write(&path, text.replacen(part, by, 1)).unwrap();
    let split = BopSplit::open(folder.path()).unwrap();
    // The other image is none the worse.
    assert_eq!(split.load(1, 7).unwrap().instances.len(), 1, "{by}");
    assert!(split.scene(1).unwrap().is_annotated(0));
    message(split.load(1, 0))
}

#[test]
fn a_broken_entry_costs_its_image_and_is_named() {
    let rotation = "[1.0,0.0,0.0,0.0,1.0,0.0,0.0,0.0,1.0]";
    for (part, by, names) in [
        (
            rotation,
            "[1.0,0.0,0.0,0.0,NaN,0.0,0.0,0.0,1.0]",
            "image 0: [0].cam_R_m2c[4]: invalid type: string \"NaN\"",
        ),
        (rotation, "[1.0,0.0,0.0,0.0,null,0.0,0.0,0.0,1.0]", "image 0: [0].cam_R_m2c[4]: invalid type: null"),
        (rotation, "[1.0,0.0,0.0]", "image 0: [0].cam_R_m2c: invalid length 3"),
        (rotation, "[1,0,0,0,1,0,0,0,-1]", "image 0 instance 0: cam_R_m2c is"),
        (rotation, "[1,0,0,0,1,0,0,0,-1]", "(determinant -1.000)"),
        (rotation, "[2,0,0,0,2,0,0,0,2]", "(determinant 8.000)"),
        (rotation, "[1,0.1,0,0,1,0,0,0,1]", "image 0 instance 0: cam_R_m2c is"),
        (rotation, "[0,0,0,0,0,0,0,0,0]", "(determinant 0.000)"),
        ("\"obj_id\":3", "\"obj_id\":-3", "image 0: [0].obj_id: -3, expected a whole number from 0"),
        ("\"obj_id\":3", "\"obj_id\":99999999999", "99999999999, expected"),
        ("\"obj_id\":3", "\"obj\":3", "image 0: [0]: missing field `obj_id`"),
        ("\"cam_t_m2c\":[0.0,0.0,1000.0]", "\"cam_t_m2c\":[0.0,Infinity,1000.0]", "[0].cam_t_m2c[1]"),
        ("\"0\":[{", "\"0\":[{},{", "image 0: [0]: missing field"),
    ] {
        let message = with_broken(part, by);
        assert!(message.contains("scene_gt.json: ") && message.contains(names), "{by}: {message}");
    }
    // An object's number written as a float is the number.
    assert_eq!(with_broken("\"obj_id\":3", "\"obj_id\":3.0"), "");
    assert_eq!(with_broken("\"obj_id\":3", "\"future\":[NaN],\"obj_id\":3"), "");
}

#[test]
fn a_file_that_says_two_things_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), 1);
    let path = folder.path().join("000001/scene_camera.json");
    let text = std::fs::read_to_string(&path).unwrap();
    for (by, part) in [
        ("\"7\":{},\"7\":", "7 is there twice"),
        ("\"007\":{},\"7\":", "7 is there twice"),
        ("\"-7\":", "key \"-7\", expected an id"),
        ("\"seven\":", "key \"seven\", expected an id"),
        ("7:", "line 1"),
    ] {
        std::fs::write(&path, text.replacen("\"7\":", by, 1)).unwrap();
        let message = message(BopSplit::open(folder.path()).unwrap().load(1, 0));
        assert!(message.contains("scene_camera.json") && message.contains(part), "{message}");
    }
    // A scene without images.
    std::fs::write(&path, "{}").unwrap();
    let split = BopSplit::open(folder.path()).unwrap();
    assert_eq!(split.scene(1).unwrap().image_ids().count(), 0);
    let absent = message(split.load(1, 0));
    assert!(absent.contains("image 0 not found (the file is absent or empty)"), "{absent}");
}

#[test]
fn visibility_that_no_file_has_is_that_of_the_masks() {
    let folder = tempfile::tempdir().unwrap();
    let split = folder.path().join("test");
    write_scene(&split, 1);
    let scene = split.join("000001");
    let info = |im_id| {
        let split = BopSplit::open(&split).unwrap();
        split.scene(1).unwrap().gt_info(im_id).map(|infos| infos[0].clone())
    };
    let written = info(0).unwrap();
    assert_eq!((written.px_count_all, written.visib_fract, written.bbox_obj), (400, 0.5, [22, 22, 19, 19]));
    // Floats, as some programs write them.
    let path = scene.join("scene_gt_info.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let floats = text.replace("[22,22,19,19]", "[22.2,21.7,19.0,19.4]").replace(":400,", ":400.0,");
    std::fs::write(&path, floats).unwrap();
    assert_eq!(info(0).unwrap(), written);
    for (by, part) in [
        ("\"visib_fract\":1.5", "visib_fract of instance 0 is 1.5, expected a share from 0 to 1"),
        ("\"visib_fract\":-1", "visib_fract of instance 0 is -1"),
        ("\"visib_fract\":NaN", "image 0: [0].visib_fract"),
    ] {
        std::fs::write(&path, text.replacen("\"visib_fract\":0.5", by, 1)).unwrap();
        let message = message(info(0));
        assert!(message.contains("scene_gt_info.json: image 0") && message.contains(part), "{message}");
        assert_eq!(info(7).unwrap(), written);
    }
    // One image lacks an entry, then all do.
    let lacking = || BopSplit::open(&split).unwrap().scene(1).unwrap().images_without_info();
    assert_eq!(lacking(), 0);
    std::fs::write(&path, text.replacen("\"7\":", "\"8\":", 1)).unwrap();
    assert_eq!((info(7).unwrap(), lacking()), (written.clone(), 1));
    std::fs::remove_file(&path).unwrap();
    assert_eq!(info(0).unwrap(), written);
    // Without whole silhouettes those of the models are taken.
    std::fs::remove_dir_all(scene.join("mask")).unwrap();
    let square = TriangleMesh {
        vertices: vec![[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    };
    std::fs::create_dir(folder.path().join("models")).unwrap();
    let mut file = std::fs::File::create(folder.path().join("models/obj_000003.ply")).unwrap();
    ply::write(&square, 1000.0, None, &mut file).unwrap();
    assert_eq!(info(0).unwrap(), written);
    // Without those either nothing hides the object.
    std::fs::remove_dir_all(folder.path().join("models")).unwrap();
    let visible = info(0).unwrap();
    assert_eq!((visible.px_count_all, visible.visib_fract, visible.bbox_obj), (200, 1.0, [32, 22, 9, 19]));
    // Not even the visible masks.
    std::fs::remove_file(scene.join("mask_visib/000000_000000.png")).unwrap();
    let message = message(info(0));
    assert!(
        message.contains("scene_gt_info.json has no image 0") && message.contains("mask_visib/000000"),
        "{message}"
    );
    write_mask(&scene.join("mask_visib/000000_000000.png"), &Mask::empty(64, 64)).unwrap();
    assert_eq!((info(0).unwrap().visib_fract, info(0).unwrap().bbox_visib), (0.0, [-1; 4]));
}
