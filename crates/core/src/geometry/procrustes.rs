//! Weighted rigid registration of matched points (Kabsch, as the release solves it).

use nalgebra::{Matrix3, Vector3};

use super::{Pose, svd::svd3};

/// The pose that maps `src` to `dst` with the least weighted squared error.
///
/// Weights strictly below `threshold` count as 0; the rest are divided by (their sum + 1e-5), which moves the
/// centroids very slightly towards the origin, as in the release. `weights = None` stands for ones. Lists are cut to the
/// shortest. Without any weight left the answer is the identity.
pub fn weighted_procrustes(
    src: &[[f32; 3]],
    dst: &[[f32; 3]],
    weights: Option<&[f32]>,
    threshold: f32,
) -> Pose {
    let weight = |i: usize| match weights {
        Some(w) => w.get(i).copied().filter(|&w| w >= threshold).unwrap_or(0.0) as f64,
        None if 1.0 >= threshold => 1.0,
        None => 0.0,
    };
    let n = src.len().min(dst.len());
    let total: f64 = (0..n).map(weight).sum::<f64>() + 1e-5;
    let (mut src_mean, mut dst_mean) = (Vector3::zeros(), Vector3::zeros());
    for i in 0..n {
        let w = weight(i) / total;
        src_mean += vector(&src[i]) * w;
        dst_mean += vector(&dst[i]) * w;
    }
    let mut covariance = Matrix3::zeros();
    for i in 0..n {
        let w = weight(i) / total;
        covariance += (vector(&src[i]) - src_mean) * w * (vector(&dst[i]) - dst_mean).transpose();
    }
    let rotation = rotation_of(&covariance);
    Pose::new(rotation, dst_mean - rotation * src_mean)
}

/// The rotation maximising trace(R H) for `H = sum w src dst^T`; directions that `H` leaves open are filled in.
pub(super) fn rotation_of(covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = svd3(covariance);
    if svd.s[0] <= 0.0 || !svd.s[0].is_finite() {
        return Matrix3::identity();
    }
    let (u0, v0, v1) = (svd.u[0], svd.v[0], svd.v[1]);
    let u1 = if svd.s[1] > 0.0 { svd.u[1] - u0 * u0.dot(&svd.u[1]) } else { Vector3::zeros() };
    let u1 = u1.try_normalize(0.5).unwrap_or_else(|| any_perpendicular(&u0));
    // V diag(1, 1, det(V U^T)) U^T without the third singular vectors.
    v0 * u0.transpose() + v1 * u1.transpose() + v0.cross(&v1) * u0.cross(&u1).transpose()
}

fn any_perpendicular(u: &Vector3<f64>) -> Vector3<f64> {
    let axis = Vector3::ith(u.iamin(), 1.0);
    (axis - u * u.dot(&axis)).normalize()
}

pub(super) fn vector(p: &[f32; 3]) -> Vector3<f64> {
    Vector3::new(p[0] as f64, p[1] as f64, p[2] as f64)
}
