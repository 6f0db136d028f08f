//! What the evidence leaves open is told, with the default network.

use unopose_core::geometry::Pose;
use unopose_infer::{Estimate, PoseEstimator, Refinement};
use unopose_nn::device::DeviceChoice;
use unopose_tests::ellipsoid_views::spheroid;

/// A query turned by 30 degrees against its reference.
fn estimate(printed: bool) -> Estimate {
    let estimator = PoseEstimator::embedded(DeviceChoice::Auto).unwrap().with_refinement(Refinement::Icp);
    let (reference, mask) = spheroid(0.0, printed);
    let reference = estimator.reference(&reference, &mask).unwrap();
    let (query, mask) = spheroid(30.0, printed);
    estimator.estimate(&reference, &query, &[mask]).pop().unwrap().unwrap()
}

/// Degrees from the pose to the true turn about the upright axis.
fn error_deg(pose: &Pose) -> f64 {
    let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::y_axis(), (-30f64).to_radians());
    Pose::new(*turn.matrix(), pose.translation).rotation_angle_deg(pose)
}

#[test]
fn a_print_fixes_the_turn_that_a_plain_body_leaves_open() {
    let printed = estimate(true);
    assert!(error_deg(&printed.t_query_reference) < 6.0, "{printed:?}");
    assert_eq!(printed.free_axis, None, "{printed:?}");
    assert!(printed.alternatives.is_empty(), "{:?}", printed.alternatives);
    let plain = estimate(false);
    let axis = plain.free_axis.unwrap();
    assert!(axis.direction.y.abs() > 0.99, "{axis:?}");
    // The upright axis through the middle, 0.6 m away.
    let off = (axis.point - nalgebra::Vector3::new(0.0, 0.0, 0.6)).cross(&axis.direction).norm();
    assert!(off < 0.005, "{axis:?}");
}
