use std::{collections::BTreeMap, path::Path};

use unopose_core::geometry::Intrinsics;

use super::*;
use crate::formats::FormatError;

const K: Intrinsics = Intrinsics { fx: 600.0, fy: 601.0, cx: 319.5, cy: 239.5 };

fn read_bytes(bytes: &[u8], depth_scale: Option<f64>) -> Result<Camera, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cam.json");
    std::fs::write(&path, bytes).unwrap();
    read_camera_scaled(&path, depth_scale)
}

fn read(text: &str) -> Result<Camera, FormatError> {
    read_bytes(text.as_bytes(), None)
}

fn message(text: &str) -> String {
    let message = read(text).unwrap_err().to_string();
    assert!(message.contains("cam.json"), "{message}");
    message
}

#[test]
fn all_forms_give_the_same_camera() {
    let forms = [
        r#"{"cam_K": [600, 0, 319.5, 0, 601.0, 239.5, 0, 0, 1], "x": []}"#,
        r#"{"fx": 600.0, "fy": 601, "cx": 319.5, "cy": 239.5, "width": 640}"#,
        r#"{"cam_K": [[600, 0, 319.5], [0, 601, 239.5], [0, 0, 1]]}"#,
        r#"{"K": ["600", "0", " 319.5", "0", "601", "239.5", "0", "0", "1"]}"#,
        "\u{feff}{\"fx\": \"600.0\", \"fy\": 601, \"cx\": 319.5, \"cy\": 239.5}",
        // RealSense.
        r#"{"width": 640, "height": 480, "ppx": 319.5, "ppy": 239.5, "fx": 600, "fy": 601, "model": 2, "coeffs": [0, 0, 0, 0, 0]}"#,
        r#"{"intrinsics": {"ppx": 319.5, "ppy": 239.5, "fx": 600, "fy": 601, "model": "distortion.inverse_brown_conrady"}}"#,
        // Open3D: an intrinsic file, and a view with one inside.
        r#"{"width": 640, "height": 480, "intrinsic_matrix": [600, 0, 0, 0, 601, 0, 319.5, 239.5, 1]}"#,
        r#"{"class_name": "PinholeCameraParameters", "extrinsic": [1, 0], "intrinsic": {"width": 640, "height": 480,
            "intrinsic_matrix": [600, 0, 0, 0, 601, 0, 319.5, 239.5, 1]}}"#,
        r#"{"intrinsic_matrix": [600, 0, 319.5, 0, 601, 239.5, 0, 0, 1]}"#,
        r#"{"intrinsic_matrix": [[600, 0, 319.5], [0, 601, 239.5], [0, 0, 1]]}"#,
        // The entries of a scene, which move.
        r#"{"3": {"cam_K": [600, 0, 319.5, 0, 601, 239.5, 0, 0, 1], "cam_t_w2c": [0, 0, 1]},
            "7": {"cam_K": [600, 0, 319.5, 0, 601, 239.5, 0, 0, 1], "cam_t_w2c": [0, 0, 2]}}"#,
        // Text.
        "6.000000000000000000e+02 0.000000000000000000e+00 3.195e+02\n0 6.01e+02 2.395e+02\n0 0 1\n",
        "# K\n[[600.    0.  319.5]\n [  0.  601.  239.5]\n [  0.    0.    1. ]]",
        "600,0,319.5\r\n0,601,239.5\r\n0,0,1\r\n",
        r#"[["600", 0, 319.5], [0, 601, 239.5], [0, 0, 1]]"#,
        // ROS: a calibration file, and messages of ROS 1 and 2.
        "image_width: 640\nimage_height: 480\ncamera_name: head\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [600, 0, 319.5, \
         0, 601, 239.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, \
         0, 0, 0]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]\n",
        "header: \n  seq: 12\n  stamp: \n    secs: 15\n    nsecs: 17\n  frame_id: \"optical\"\nheight: 480\nwidth: 640\n\
         distortion_model: \"plumb_bob\"\nD: [0.0, 0.0, 0.0, 0.0, 0.0]\nK: [600.0, 0.0, 319.5, 0.0, 601.0, 239.5, 0.0, 0.0, 1.0]\n\
         R: [1.0, 0.0, 0.0]\nbinning_x: 0\n---\n",
        "height: 480\nwidth: 640\ndistortion_model: ''\nd: []\nk:\n- 600.0\n- 0.0\n- 319.5\n- 0.0\n- 601.0\n- 239.5\n- 0.0\n- 0.0\n- 1.0\n",
        // OpenCV.
        "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 600., 0., 319.5, 0.,\n       \
         601., 239.5, 0., 0., 1. ]\n",
    ];
    for form in forms {
        let camera = read(form).unwrap_or_else(|error| panic!("{form}: {error}"));
        assert_eq!((camera.intrinsics, camera.depth_scale), (K, None), "{form}");
        camera.check_size("cam.json", (640, 480)).unwrap();
        assert!(camera.undistortion("cam.json", (640, 480)).unwrap().is_none(), "{form}");
        if form.contains("640") {
            let message = camera.check_size("cam.json", (320, 240)).unwrap_err().to_string();
            assert!(message.contains("image size is 640 x") && message.contains("320 x 240"), "{message}");
        }
        assert_eq!(read_bytes(form.as_bytes(), Some(0.1)).unwrap().depth_scale, Some(0.1));
    }
}

#[test]
fn a_missing_scale_is_no_scale() {
    let text = r#"{"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#;
    let message_of = |result: Result<f64, FormatError>| result.unwrap_err().to_string();
    let message = message_of(read(text).unwrap().require_depth_scale(Path::new("cam.json")));
    assert!(message.contains("cam.json: depth_scale not found") && message.contains("0.1"), "{message}");
    assert!(message.contains("--depth-scale"), "{message}");
    for key in ["depthScale", "depth_scal", "Depth-Scale", "depth_units", "scale"] {
        let text = format!(r#"{{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "{key}": 0.1}}"#);
        let message = read(&text).unwrap_err().to_string();
        assert!(message.contains("depth_scale not found") && message.contains(key), "{message}");
        assert_eq!(read_bytes(text.as_bytes(), Some(0.5)).unwrap().depth_scale, Some(0.5));
    }
}

#[test]
fn scales_of_other_meanings_are_refused() {
    let with = |scale: &str| {
        format!(r#"{{"fx": 600, "fy": 601, "cx": 319.5, "cy": 239.5, "depth_scale": {scale}}}"#)
    };
    assert_eq!(read(&with("\"0.1\"")).unwrap().depth_scale, Some(0.1));
    assert_eq!(read(&with("1000")).unwrap().depth_scale, Some(1000.0));
    // Metres per unit, as RealSense has it.
    assert!(
        message(&with("0.001")).contains("depth_scale is 0.001, expected 0.002 to 1000 millimetres per unit")
    );
    assert!(message(&with("1e308")).contains("depth_scale is 1e308"));
    assert!(message(&with("\"much\"")).contains("depth_scale is \"much\", expected a number"));
    let open3d = r#"{"intrinsic_matrix": [600, 0, 0, 0, 601, 0, 319.5, 239.5, 1], "depth_scale": 1000.0}"#;
    assert!(
        message(open3d).contains("units per metre, which are 1 millimetres per unit"),
        "{}",
        message(open3d)
    );
    let other = read_bytes(with("0.1").as_bytes(), Some(1.0)).unwrap_err().to_string();
    assert!(other.contains("depth_scale is 0.1, expected 1 as given"), "{other}");
    assert!(read_bytes(with("0.1").as_bytes(), Some(0.1)).is_ok());
}

#[test]
fn unusable_cameras_are_named() {
    for (text, part) in [
        (r#"{"cam_K": [0, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "fx is 0"),
        (r#"{"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1], "depth_scale": 0}"#, "depth_scale is 0"),
        (r#"{"cam_K": [NaN, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "line 1"),
        (r#"{"cam_K": [null, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}"#, "cam_K is [null,0,319.5"),
        (r#"{"cam_K": [600, 0, 319.5, 0, 600]}"#, "cam_K is a list of 5 numbers, expected 9"),
        (r#"{"cam_K": [600, 0, 0, 0, 600, 0, 319.5, 239.5, 1]}"#, "cam_K[6] is 319.5, expected 0 (row-major"),
        (r#"{"fx": 600, "cx": 319.5, "cy": 239.5}"#, "fy not found"),
        (r#"{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "width": 640.5}"#, "width is 640.5"),
        (
            r#"{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "K": [500, 0, 1, 0, 500, 1, 0, 0, 1]}"#,
            "as in K",
        ),
        (r#"{"depth_scale": 1.0}"#, "camera not found"),
        (r#"{"cam_K": [600, 0, 1e308, 0, 600, 55.5, 0, 0, 1]}"#, "cx is 1e308 px, expected"),
        (
            r#"{"fx": 0.9, "fy": 0.9, "cx": 0.5, "cy": 0.4, "width": 640, "height": 480}"#,
            "fx is 0.9 px, expected 32.0 to",
        ),
        (
            r#"{"0": {"cam_K": [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1]}, "1": {"cam_K": [700, 0, 319.5, 0, 700, 239.5, 0, 0, 1]}}"#,
            "another in image 1 than in image 0",
        ),
        ("{}", "camera not found"),
        ("", "camera not found"),
        ("1 2 3 4", "4 numbers, expected 9"),
        ("a camera", "camera not found"),
        ("camera_matrix: [1, 2\nb: }", "camera file is no JSON, YAML or matrix"),
        ("K: [.nan, 0, 1, 0, 1, 1, 0, 0, 1]", "(line 1 column 5: non-finite float `.nan`"),
    ] {
        let message = message(text);
        assert!(message.contains(part), "{message}");
    }
    let message = read_bytes(&[b'f', 0xff, 0xfe], None).unwrap_err().to_string();
    assert!(message.contains("no UTF-8 from byte 1"), "{message}");
}

#[test]
fn lenses_are_undone_or_refused_by_name() {
    let with = |more: &str| format!(r#"{{"fx": 600, "fy": 601, "cx": 319.5, "cy": 239.5, {more}}}"#);
    for lens in [
        r#""D": [-0.1, 0.02, 0.001, -0.001, 0.003]"#,
        r#""dist_coeffs": [[-0.1, 0.02, 0.001, -0.001]], "distortion_model": "radtan""#,
        r#""coeffs": [-0.1, 0, 0, 0, 0], "model": "Brown Conrady""#,
        r#""coeffs": [-0.1, 0, 0, 0, 0], "model": 4"#,
        r#""distortion": {"k1": -0.1, "model": "plumb_bob"}"#,
        r#""k1": -0.1, "k2": 0.01"#,
        r#""D": [0.3, 0.1, 0.001, 0, 0, 0.4, 0.05, 0.01], "distortion_model": "rational_polynomial""#,
        r#""D": [0.3, 0.1, 0, 0, 0, 0.4, 0, 0, 0, 0, 0, 0], "distortion_model": "rational_polynomial""#,
    ] {
        let camera = read(&with(lens)).unwrap_or_else(|error| panic!("{lens}: {error}"));
        let map = camera.undistortion("cam.json", (640, 480)).unwrap().expect(lens);
        assert!(map.covered() > 0.9, "{lens}");
    }
    for (lens, parts) in [
        (
            r#""D": [0, 0, 0, 0], "distortion_model": "equidistant""#,
            ["distortion_model is \"equidistant\"", "plumb_bob"],
        ),
        (r#""D": [1, 0, 0, 0], "distortion_model": "fisheye""#, ["fisheye", "undistorted before"]),
        (
            r#""coeffs": [-0.05, 0, 0, 0, 0], "model": "Inverse Brown Conrady""#,
            ["inversebrownconrady", "-0.05"],
        ),
        (r#""coeffs": [-0.05, 0, 0, 0, 0], "model": 2"#, ["inversebrownconrady", "-0.05"]),
        (r#""coeffs": [0, 0, 0, 0, 0], "model": 9"#, ["model is 9", "0 to 5"]),
        (r#""D": [0.1, 0.1]"#, ["D is a list of 2 numbers", "k1, k2, p1, p2"]),
        (r#""D": [0.1, 0, 0, 0, 0, 0, 0, 0, 0.5, 0, 0, 0]"#, ["thin prisms", "0.5"]),
        (r#""D": ["nan", 0, 0, 0]"#, ["D is NaN", "finite"]),
        (r#""D": {"x": 1}, "distortion": 7, "distortion_model": []"#, ["distortion_model is []", "name"]),
    ] {
        let message = message(&with(lens));
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    let absurd = read(&with(r#""D": [1e30, 0, 0, 0]"#)).unwrap();
    let message = absurd.undistortion("cam.json", (640, 480)).unwrap_err().to_string();
    assert!(message.contains("cam.json: lens distortion is one that leaves 0 % of the image"), "{message}");
}

#[test]
fn images_of_datasets_have_no_lens() {
    let text =
        r#"{"cam_K": [600, 0, 319.5, 0, 601, 239.5, 0, 0, 1], "depth_scale": "0.1", "D": [0.1, 0, 0, 0]}"#;
    let record: CameraRecord = serde_json::from_str(text).unwrap();
    assert_eq!((record.cam_k, record.depth_scale), (K.to_cam_k(), Some(0.1)));
    let message = record.check("scene_camera.json: image 3").unwrap_err().to_string();
    assert!(message.contains("scene_camera.json: image 3: lens distortion is [0.1"), "{message}");
    let written = serde_json::to_string(&CameraRecord { distortion: None, ..record }).unwrap();
    assert_eq!(written, r#"{"cam_K":[600.0,0.0,319.5,0.0,601.0,239.5,0.0,0.0,1.0],"depth_scale":0.1}"#);
    let scene = serde_json::from_str::<BTreeMap<u32, CameraRecord>>("{\"7\":\n{\"cam_K\": [1, 2]}}");
    let message = scene.unwrap_err().to_string();
    assert!(message.contains("cam_K is a list of 2 numbers") && message.contains("line 2"), "{message}");
}

#[test]
fn mutated_files_are_cameras_or_errors() {
    let seeds = [
        r#"{"fx": 600, "fy": 601, "cx": 319.5, "cy": 239.5, "depth_scale": 0.1, "D": [-0.1, 0.02, 0.001, -0.001, 0.003]}"#,
        "image_width: 64\nimage_height: 48\nK: [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]\nD: [-0.1, 0.02, 0.001, -0.001, 0.003]\n",
        "600 0 319.5\n0 601 239.5\n0 0 1\n",
    ];
    let mut state = 1u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    let parts: [&[u8]; 10] = [b"e99", b"-", b"[", b"]", b"&a", b"*a", b"\0", b"1e-300", b": ", b"\xff"];
    for _ in 0..1500 {
        let mut bytes = seeds[random(seeds.len())].as_bytes().to_vec();
        for _ in 0..1 + random(4) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] = random(256) as u8,
                1 => drop(bytes.drain(at..(at + random(9)).min(bytes.len()))),
                _ => drop(bytes.splice(at..at, parts[random(parts.len())].iter().copied())),
            }
            if bytes.is_empty() {
                bytes.push(b'0');
            }
        }
        if let Ok(camera) = read_bytes(&bytes, Some(0.1)) {
            let Intrinsics { fx, fy, cx, cy } = camera.intrinsics;
            assert!(fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.abs() <= 1e7));
            if camera.check_size("cam", (64, 48)).is_ok() {
                let map = camera.undistortion("cam", (64, 48));
                assert!(map.is_err() || map.is_ok_and(|map| map.is_none_or(|map| map.covered() >= 0.5)));
            }
        }
    }
}
