//! How far a refinement moves a pose.

use nalgebra::Vector3;
use unopose_core::geometry::Pose;

/// Largest translation of the reference's centre in a refinement, metres.
pub const MAX_TRANSLATION: f64 = 0.03;
/// Largest rotation of a refinement, degrees.
pub const MAX_ROTATION_DEG: f64 = 15.0;

/// Distance of the reference's centre, metres, and angle, degrees, between two poses.
pub fn motion(a: &Pose, b: &Pose, center: &Vector3<f64>) -> [f64; 2] {
    let at = |pose: &Pose| pose.rotation * center + pose.translation;
    [(at(a) - at(b)).norm(), a.rotation_angle_deg(b)]
}
