//! A phone sequence of equal images.

use unopose_core::frame::{DepthMap, Mask};
use unopose_dataset::formats::{
    PhoneSequence,
    image_io::{write_depth, write_mask, write_rgb},
};
use unopose_pairs::registration::{AlignCenter, Refinement, classical_method};

use super::super::*;

#[test]
fn a_sequence_is_judged_by_its_camera_poses() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::write(root.join("metadata"), r#"{"K": [50, 0, 0, 0, 50, 0, 15.5, 15.5, 1]}"#).unwrap();
    // Three equal images; the third camera is said to be turned by 20 degrees about its axis.
    let (sin, cos) = 20f64.to_radians().sin_cos();
    let poses = format!(
        "0 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n1 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n2 {cos} {} 0 0 {sin} {cos} 0 0 0 0 1 0 0 0 0 1\n",
        -sin
    );
    std::fs::write(root.join("cam_poses.txt"), poses).unwrap();
    let mask = Mask { data: vec![true; 32 * 32], ..Mask::empty(32, 32) };
    for id in 0..3 {
        write_rgb(&root.join(format!("rgb/{id:05}.png")), &image::RgbImage::new(32, 32)).unwrap();
        let depth = DepthMap { width: 32, height: 32, data: vec![0.5; 32 * 32] };
        write_depth(&root.join(format!("depth/{id:05}.png")), &depth, 1.0).unwrap();
        write_mask(&root.join(format!("masks/{id:05}.png")), &mask).unwrap();
    }
    let sequence = PhoneSequence::open(root).unwrap();
    let methods = [
        Method { estimator: Box::new(AlignCenter), switches: None },
        Method { estimator: classical_method("ppf").unwrap(), switches: None },
    ];
    let out = root.join("out");
    let runs = run_sequence(&sequence, 0, 1, &methods, &[Refinement::None], &out).unwrap();
    let run = &runs[0];
    assert!((run.angular_error_deg - 10.0).abs() < 1e-9, "{run:?}");
    assert_eq!((run.acc15, run.acc30, run.within_5deg_5cm, run.without_pose), (0.5, 1.0, 0.5, 0));
    // A plane has no pose for point-pair features.
    assert_eq!((runs[1].angular_error_deg, runs[1].without_pose), (180.0, 2));
    let table = std::fs::read_to_string(out.join("sequence.md")).unwrap();
    assert!(table.contains("| aligncenter | 10.0 | 50.0 | 100.0 | 50.0 |"), "{table}");
    assert!(run_sequence(&sequence, 9, 1, &methods, &[Refinement::None], &out).is_err());
}
