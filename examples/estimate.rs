//! The pose of an object between two views, with the library alone: `cargo run --release --example estimate`.
//!
//! The views are made here, of a painted figure of four ellipsoids, so that the true pose is known.

use unopose::{
    DepthMap, DeviceChoice, Intrinsics, Mask, Pose, PoseEstimator, Refinement, RgbdFrame,
    image::{Rgb, RgbImage},
    nalgebra::{Rotation3, Vector3},
};

/// Centre and half axes of the figure's parts, metres.
const PARTS: [([f64; 3], [f64; 3]); 4] = [
    ([0.0, 0.0, 0.0], [0.08, 0.05, 0.04]),
    ([0.07, -0.04, 0.01], [0.035, 0.03, 0.03]),
    ([-0.05, 0.05, 0.0], [0.015, 0.04, 0.015]),
    ([0.02, 0.02, -0.045], [0.03, 0.02, 0.025]),
];

fn main() -> anyhow::Result<()> {
    let t_reference_object = pose([0.3, 0.2, 0.1], [0.0, 0.0, 0.6]);
    let t_query_object = pose([0.6, -0.1, 0.4], [0.05, -0.03, 0.7]);
    let (reference_frame, reference_mask) = view(&t_reference_object);
    let (query_frame, query_mask) = view(&t_query_object);

    let estimator = PoseEstimator::load_default(DeviceChoice::Auto)?.with_refinement(Refinement::Icp);
    // Once per object; then any number of queries.
    let reference = estimator.reference(&reference_frame, &reference_mask)?;
    for result in estimator.estimate(&reference, &query_frame, &[query_mask]) {
        let estimate = result?;
        let truth = t_query_object * t_reference_object.inverse();
        println!("T_query_reference: {}", estimate.t_query_reference.rotation);
        println!("translation (m): {}", estimate.t_query_reference.translation.transpose());
        println!("score {:.2}, overlap {:.2}", estimate.score, estimate.overlap[0]);
        println!(
            "off by {:.2} degrees, {:.1} mm, in {:.3} s",
            estimate.t_query_reference.rotation_angle_deg(&truth),
            1000.0 * (estimate.t_query_reference * t_reference_object).translation_distance(&t_query_object),
            estimate.timings.total
        );
    }
    Ok(())
}

fn pose(turn: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::new(*Rotation3::new(Vector3::from(turn)).matrix(), Vector3::from(translation))
}

/// Colour, depth and mask of the figure.
fn view(t_camera_object: &Pose) -> (RgbdFrame, Mask) {
    let intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
    let (width, height) = (640, 480);
    let mut rgb = RgbImage::from_pixel(width, height, Rgb([90, 90, 90]));
    let (mut depth, mut mask) = (DepthMap::zeros(width, height), Mask::empty(width, height));
    let t_object_camera = t_camera_object.inverse();
    for (index, (col, row)) in (0..height).flat_map(|row| (0..width).map(move |col| (col, row))).enumerate() {
        let ray = intrinsics.back_project(col.into(), row.into(), 1.0).coords;
        let direction = t_object_camera.rotation * ray;
        let hit = PARTS
            .iter()
            .enumerate()
            .filter_map(|(part, shape)| {
                Some((first_hit(&t_object_camera.translation, &direction, shape)?, part))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((z, part)) = hit {
            depth.data[index] = z as f32;
            mask.data[index] = true;
            let p = t_object_camera.translation + direction * z;
            let wave = |v: f64| (127.0 + 110.0 * (v * 120.0 + part as f64).sin()) as u8;
            rgb.put_pixel(col, row, Rgb([wave(p.x), wave(p.y + 0.5 * p.x), wave(p.z)]));
        }
    }
    (RgbdFrame { rgb, depth, intrinsics }, mask)
}

/// Parameter of the first intersection of a ray with an ellipsoid.
fn first_hit(
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    (center, half): &([f64; 3], [f64; 3]),
) -> Option<f64> {
    let half = Vector3::from(*half);
    let (o, d) = ((origin - Vector3::from(*center)).component_div(&half), direction.component_div(&half));
    let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
    let discriminant = b * b - a * c;
    (discriminant > 0.0).then(|| (-b - discriminant.sqrt()) / a)
}
