//! Images as people bring them: other formats of depth, cut-outs and label maps as masks, paths that are no text.

use unopose_dataset::formats::{
    files::read_json,
    image_io::{read_depth, read_mask, read_rgb},
};

use super::infer::Files;

fn pose(files: &Files) -> serde_json::Value {
    let value: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    value["T_query_reference"].clone()
}

#[test]
fn the_same_images_in_other_formats_give_the_same_pose() {
    let files = Files::new();
    assert!(files.estimate(&[], &[]).status.success());
    let expected = pose(&files);
    let depth = read_depth(&files.at("query/depth/a.png"), 0.1).unwrap();
    let rows = depth.data.chunks(depth.width as usize).rev().flatten();
    let pfm: Vec<u8> = rows.flat_map(|z| z.to_le_bytes()).collect();
    let header = format!("Pf\n{} {}\n-1\n", depth.width, depth.height);
    std::fs::write(files.at("depth.pfm"), [header.as_bytes(), &pfm].concat()).unwrap();
    let mask = read_mask(&files.at("query/mask/a_0.png")).unwrap();
    let other = read_mask(&files.at("query/mask/a_1.png")).unwrap();
    let rgb = read_rgb(&files.at("query/rgb/a.png")).unwrap();
    let cut_out = image::RgbaImage::from_fn(mask.width, mask.height, |x, y| {
        let [r, g, b] = rgb.get_pixel(x, y).0;
        image::Rgba([r | 1, g, b, if mask.get(x, y) { 255 } else { 0 }])
    });
    cut_out.save(files.at("cut.png")).unwrap();
    let labels = image::GrayImage::from_fn(mask.width, mask.height, |x, y| {
        image::Luma([if mask.get(x, y) { 3 } else { 7 * u8::from(other.get(x, y)) }])
    });
    labels.save(files.at("labels.png")).unwrap();
    let output = files.estimate(&[("--query-depth", "depth.pfm"), ("--query-mask", "cut.png")], &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(pose(&files), expected);
    let values = ["--mask-value", "3", "--reference-mask-value", "255"];
    let output = files.estimate(&[("--query-mask", "labels.png")], &values);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(pose(&files), expected);
    std::fs::remove_dir_all(files.at("out")).unwrap();
    files.refused(&[("--query-mask", "labels.png")], "labels.png", "mask values is 3, 7");
}

#[cfg(unix)]
#[test]
fn a_path_need_not_be_text() {
    use std::os::unix::ffi::OsStrExt;
    let files = Files::new();
    let mask = files.at("").join(std::ffi::OsStr::from_bytes(b"\xff.png"));
    std::fs::copy(files.at("query/mask/a_0.png"), &mask).unwrap();
    let named = [
        ("--query-rgb", "query/rgb/a.png"),
        ("--query-depth", "query/depth/a.png"),
        ("--reference-rgb", "reference/rgb/a.png"),
        ("--reference-depth", "reference/depth/a.png"),
        ("--reference-mask", "reference/mask/a_0.png"),
        ("--camera", "camera.json"),
        ("--checkpoint", "weights.safetensors"),
        ("--out", "out"),
    ];
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_unoinfer"));
    command.arg("estimate").arg("--query-mask").arg(&mask);
    let output =
        command.args(named.iter().flat_map(|(f, file)| [(*f).into(), files.at(file).into_os_string()]));
    let output = output.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let value: serde_json::Value = read_json(&files.at("out/pose.json")).unwrap();
    assert!(value["instances"][0]["mask"].as_str().unwrap().ends_with("\u{fffd}.png"));
}
