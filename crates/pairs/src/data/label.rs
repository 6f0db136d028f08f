//! The pose between two views of an object.

use unopose_core::geometry::{Pose, nearest_distances};
use unopose_dataset::formats::ObjectSymmetries;

/// Step of continuous symmetries: 315 rotations, one every 1.1 degrees.
const SYMMETRY_STEP: f64 = 0.01;

/// Reference camera to query camera. Of the poses that the object's symmetries make equivalent, the one with the
/// smallest rotation.
pub fn relative_pose(
    t_query_object: &Pose,
    t_reference_object: &Pose,
    symmetries: &ObjectSymmetries,
) -> Pose {
    let t_object_reference = t_reference_object.inverse();
    let plain = *t_query_object * t_object_reference;
    if symmetries.is_empty() {
        return plain;
    }
    // The trace of a rotation falls with its angle.
    symmetries
        .expand(SYMMETRY_STEP)
        .into_iter()
        .map(|s| *t_query_object * s * t_object_reference)
        .max_by(|a, b| a.rotation.trace().total_cmp(&b.rotation.trace()))
        .unwrap_or(plain)
}

/// Share of query points with a reference point closer than `within` under the pose, all in one unit.
pub fn overlap_share(
    query: &[[f32; 3]],
    reference: &[[f32; 3]],
    t_query_reference: &Pose,
    within: f32,
) -> f64 {
    let moved: Vec<[f32; 3]> = reference.iter().map(|p| t_query_reference.transform_f32(p)).collect();
    let near = nearest_distances(query, &moved).into_iter().filter(|&d| d <= within).count();
    near as f64 / query.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use unopose_dataset::formats::SymmetryAxis;

    use super::*;

    fn about_z(degrees: f64) -> Pose {
        Pose::new(*Rotation3::new(Vector3::z() * degrees.to_radians()).matrix(), Vector3::new(0.1, -0.2, 0.7))
    }

    #[test]
    fn symmetric_views_get_the_smallest_rotation() {
        let (query, reference) = (about_z(170.0), about_z(10.0));
        let half_turn = Pose::new(Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)), Vector3::zeros());
        let angle = |symmetries: &ObjectSymmetries| {
            relative_pose(&query, &reference, symmetries).rotation_angle_deg(&Pose::identity())
        };
        assert!((angle(&ObjectSymmetries::default()) - 160.0).abs() < 1e-9);
        let discrete = ObjectSymmetries { discrete: vec![half_turn], continuous: vec![] };
        assert!((angle(&discrete) - 20.0).abs() < 1e-9);
        let axis = SymmetryAxis { axis: Vector3::z(), offset: Vector3::zeros() };
        let round = ObjectSymmetries { discrete: vec![], continuous: vec![axis] };
        assert!(angle(&round) < 0.6);
        // The object's origin stays where it is seen.
        let label = relative_pose(&query, &reference, &round);
        let origin = label.transform(&nalgebra::Point3::from(reference.translation));
        assert!((origin.coords - query.translation).norm() < 1e-12);
    }

    #[test]
    fn overlap_counts_query_points_near_the_reference() {
        let query = [[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, 0.1, 1.0], [3.0, 0.0, 1.0]];
        let shift = Pose::new(Matrix3::identity(), Vector3::new(0.0, 0.0, 1.0));
        let share = overlap_share(&query, &[[0.0, 0.0, 0.0], [0.5, 0.05, 0.0]], &shift, 0.11);
        assert_eq!(share, 0.75);
    }
}
