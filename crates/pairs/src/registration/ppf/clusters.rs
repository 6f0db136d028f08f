//! Pose clustering (Drost et al., section 3.5).

use nalgebra::{Matrix4, Quaternion, Rotation3, SymmetricEigen, UnitQuaternion, Vector3, Vector4};
use unopose_core::geometry::Pose;

use super::voting::VotedPose;

/// The mean of the cluster with the most votes. A pose joins the first cluster, of those by descending votes of their
/// first pose, that it is near to: less than `distance` metres at `center` and `angle_deg` degrees.
pub fn heaviest_cluster(
    mut poses: Vec<VotedPose>,
    center: &Vector3<f64>,
    distance: f64,
    angle_deg: f64,
) -> Option<Pose> {
    poses.sort_by(|a, b| b.votes.total_cmp(&a.votes));
    let at = |pose: &Pose| pose.rotation * center + pose.translation;
    let mut clusters: Vec<Vec<VotedPose>> = Vec::new();
    for voted in poses {
        let near = clusters.iter_mut().find(|cluster| {
            let first = &cluster[0].pose;
            (at(first) - at(&voted.pose)).norm() < distance
                && first.rotation_angle_deg(&voted.pose) < angle_deg
        });
        match near {
            Some(cluster) => cluster.push(voted),
            None => clusters.push(vec![voted]),
        }
    }
    let votes = |cluster: &[VotedPose]| cluster.iter().map(|v| v.votes).sum::<f64>();
    let heaviest = clusters.into_iter().max_by(|a, b| votes(a).total_cmp(&votes(b)))?;
    Some(mean(&heaviest, center))
}

/// Mean by votes: of the positions of `center`, and of the rotations as unit quaternions up to sign (Markley et al. 2007).
fn mean(cluster: &[VotedPose], center: &Vector3<f64>) -> Pose {
    let (mut outer, mut position, mut total) = (Matrix4::zeros(), Vector3::zeros(), 0.0);
    for VotedPose { pose, votes } in cluster {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation));
        outer += q.coords * q.coords.transpose() * *votes;
        position += (pose.rotation * center + pose.translation) * *votes;
        total += votes;
    }
    let eigen = SymmetricEigen::new(outer);
    let q: Vector4<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let rotation = *UnitQuaternion::from_quaternion(Quaternion::from(q)).to_rotation_matrix().matrix();
    Pose::new(rotation, position / total - rotation * center)
}
