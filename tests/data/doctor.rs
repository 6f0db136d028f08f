//! What the doctor says of real frames, whose masks and units are right.

use std::path::{Path, PathBuf};

use unopose_core::frame::{MaskedView, RgbdFrame};
use unopose_dataset::formats::{
    camera::read_camera,
    image_io::{read_depth, read_mask, read_rgb},
};
use unopose_doctor::{Check, Expected, Level, findings, quick_findings};
use unopose_tests::shared;

/// Colour, depth, camera and masks of a frame.
struct Files {
    rgb: PathBuf,
    depth: PathBuf,
    camera: PathBuf,
    masks: Vec<PathBuf>,
}

fn frames(real: &Path) -> Vec<Files> {
    let table = real.join("kinect_tabletop");
    let mut frames: Vec<Files> = (1..=3)
        .map(|i| {
            let file = |kind: &str| table.join(format!("{i:06}-{kind}.png"));
            let masks = vec![file("mask-soup")];
            Files { rgb: file("color"), depth: file("depth"), camera: table.join("camera.json"), masks }
        })
        .collect();
    let entries = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    for folder in entries(&real.join("mixed")).filter(|path| path.is_dir()) {
        let is_mask = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with("mask_");
        frames.push(Files {
            rgb: folder.join("rgb.png"),
            depth: folder.join("depth.png"),
            camera: folder.join("camera.json"),
            masks: entries(&folder).filter(is_mask).collect(),
        });
    }
    frames
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn real_frames_have_nothing_wrong_and_a_tenfold_unit_is_named() {
    let frames = frames(&shared("real"));
    let mut masks = 0;
    for files in &frames {
        let camera = read_camera(&files.camera).unwrap();
        let scale = camera.depth_scale.unwrap();
        let depth = read_depth(&files.depth, scale).unwrap();
        let frame = RgbdFrame { rgb: read_rgb(&files.rgb).unwrap(), depth, intrinsics: camera.intrinsics };
        for path in &files.masks {
            masks += 1;
            let mask = read_mask(path).unwrap();
            let expected = Expected { depth_scale: Some(scale), points: 512 };
            for finding in findings(MaskedView { frame: &frame, mask: &mask }, &expected) {
                assert!(finding.level < Level::Wrong, "{}: {finding}", path.display());
                assert!(
                    finding.check != Check::Unit || finding.level == Level::Ok,
                    "{}: {finding}",
                    path.display()
                );
            }
            let mut far = frame.clone();
            far.depth.data.iter_mut().for_each(|z| *z *= 10.0);
            let expected = Expected { depth_scale: Some(10.0 * scale), points: 512 };
            let found = quick_findings(MaskedView { frame: &far, mask: &mask }, &expected);
            let unit = found.iter().find(|finding| finding.check == Check::Unit).unwrap();
            assert!(unit.level > Level::Ok, "{}: {unit}", path.display());
            let advice = format!("depth_scale of {scale} instead of");
            assert!(unit.advice.contains(&advice), "{}: {unit}", path.display());
        }
    }
    assert!(masks >= 3, "{masks} masks in {} frames", frames.len());
}
