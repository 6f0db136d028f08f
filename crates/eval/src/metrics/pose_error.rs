//! Errors of an estimated pose that compare model points: MSSD, MSPD, ADD, ADD-S, and plain rotation and translation
//! errors.

use nalgebra::{Vector2, Vector3};
use unopose_core::geometry::{Intrinsics, Pose};

use super::object::EvalObject;

/// Maximum symmetry-aware surface distance, metres: the largest vertex displacement, for the symmetry with
/// the smallest. Infinite when the bounding spheres of both poses do not meet.
pub fn mssd(object: &EvalObject, t_est: &Pose, t_gt: &Pose) -> f64 {
    if t_est.translation_distance(t_gt) >= object.diameter {
        return f64::INFINITY;
    }
    let vertices = vertices(object);
    let estimated: Vec<Vector3<f64>> = vertices.iter().map(|v| apply(t_est, v)).collect();
    smallest_of_largest(object, t_gt, f64::INFINITY, |t, i| {
        (estimated[i] - apply(t, &vertices[i])).norm_squared()
    })
}

/// Maximum symmetry-aware projection distance, pixels.
pub fn mspd(object: &EvalObject, camera: &Intrinsics, t_est: &Pose, t_gt: &Pose) -> f64 {
    let vertices = vertices(object);
    let project = |p: Vector3<f64>| Vector2::new(camera.fx * p.x / p.z, camera.fy * p.y / p.z);
    let estimated: Vec<Vector2<f64>> = vertices.iter().map(|v| project(apply(t_est, v))).collect();
    smallest_of_largest(object, t_gt, f64::INFINITY, |t, i| {
        let squared = (estimated[i] - project(apply(t, &vertices[i]))).norm_squared();
        // A vertex in the camera plane has no projection.
        if squared.is_nan() { f64::INFINITY } else { squared }
    })
}

/// Average distance between the model points of both poses, metres (Hinterstoisser et al., ACCV 2012); symmetries are not
/// looked at. Infinite when the bounding spheres do not meet.
pub fn add(object: &EvalObject, t_est: &Pose, t_gt: &Pose) -> f64 {
    mean_distance(object, t_est, t_gt, |v| (apply(t_est, v) - apply(t_gt, v)).norm())
}

/// [`add()`] with the distance of every true model point to the nearest estimated one (ADI there, ADD-S since).
pub fn add_s(object: &EvalObject, t_est: &Pose, t_gt: &Pose) -> f64 {
    let t_est_gt = t_est.inverse() * *t_gt;
    mean_distance(object, t_est, t_gt, |v| {
        object.distance_to_vertices(&apply(&t_est_gt, v).cast::<f32>().into())
    })
}

fn mean_distance(
    object: &EvalObject,
    t_est: &Pose,
    t_gt: &Pose,
    distance: impl Fn(&Vector3<f64>) -> f64,
) -> f64 {
    let vertices = vertices(object);
    if t_est.translation_distance(t_gt) >= object.diameter || vertices.is_empty() {
        return f64::INFINITY;
    }
    vertices.iter().map(distance).sum::<f64>() / vertices.len() as f64
}

/// Smallest rotation angle between two poses over the symmetries, degrees.
pub fn rotation_error_deg(object: &EvalObject, t_est: &Pose, t_gt: &Pose) -> f64 {
    // The largest trace belongs to the smallest angle.
    let relative = t_est.rotation.transpose() * t_gt.rotation;
    let trace = |s: &Pose| (relative * s.rotation).trace();
    let best = object.symmetries.iter().max_by(|a, b| trace(a).total_cmp(&trace(b)));
    best.map_or(f64::NAN, |s| {
        t_est.rotation_angle_deg(&Pose::new(t_gt.rotation * s.rotation, t_gt.translation))
    })
}

/// `sqrt(min over symmetries of max over vertices of squared(t_gt * symmetry, vertex))`.
fn smallest_of_largest(
    object: &EvalObject,
    t_gt: &Pose,
    start: f64,
    squared: impl Fn(&Pose, usize) -> f64,
) -> f64 {
    let count = object.mesh.vertices.len();
    // The vertex that was farthest for one symmetry mostly settles the next one at once.
    let mut farthest = 0;
    let best = object.symmetries.iter().fold(start, |best, symmetry| {
        let t = *t_gt * *symmetry;
        if squared(&t, farthest) >= best {
            return best;
        }
        let mut largest = 0.0;
        for i in 0..count {
            let value = squared(&t, i);
            if value > largest {
                (largest, farthest) = (value, i);
                if largest >= best {
                    return best;
                }
            }
        }
        largest
    });
    best.sqrt()
}

fn vertices(object: &EvalObject) -> Vec<Vector3<f64>> {
    object.mesh.vertices.iter().map(|v| Vector3::from(v.map(f64::from))).collect()
}

fn apply(pose: &Pose, v: &Vector3<f64>) -> Vector3<f64> {
    pose.rotation * v + pose.translation
}
