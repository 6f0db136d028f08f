//! Both views of a training pair sampled and changed at random, the pose changed with them (`docs/network.md`, section
//! 8).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use unopose_core::{
    config::{AugmentationConfig, DataConfig, ModelConfig},
    frame::RgbdFrame,
    geometry::Pose,
};

use super::{
    DataError,
    dilation::dilated,
    frame_cache::CachedInstance,
    selection::{SampledView, SelectionOptions, select_query, select_reference},
};

/// Fewest query points in training.
const MIN_POINTS: usize = 32;

/// A sampled pair, metres.
pub struct AugmentedPair {
    pub query: SampledView,
    pub reference: SampledView,
    /// Of the reference, metres.
    pub radius: f32,
    /// Reference to query.
    pub pose: Pose,
}

/// Samples the views [query, reference] that `pose` relates; with `augment` also changes them.
pub fn augmented_pair(
    [query_frame, reference_frame]: [&RgbdFrame; 2],
    [query, reference]: [&CachedInstance; 2],
    pose: Pose,
    data: &DataConfig,
    model: &ModelConfig,
    augment: bool,
    rng: &mut ChaCha8Rng,
) -> Result<AugmentedPair, DataError> {
    let config = &data.augmentation;
    let keep_zero_depth = model.quirks.keep_zero_depth;
    let options = |rng: &mut ChaCha8Rng| {
        let changed = augment && rng.random_bool(config.color_probability);
        let color_augmentation = changed.then(|| ChaCha8Rng::seed_from_u64(rng.random()));
        SelectionOptions { keep_zero_depth, min_points: MIN_POINTS, color_augmentation }
    };

    let reference_options = options(rng);
    let (mut reference, radius) =
        select_reference(reference_frame, &reference.mask(), model, reference_options, rng)?;
    let mut mask = query.mask();
    if augment && rng.random_bool(config.dilation_probability) {
        mask = dilated(&mask, config.dilation_iterations);
    }
    let query_options = options(rng);
    let mut query = select_query(query_frame, &mask, radius, model, query_options, rng)?;

    let mut pose = pose;
    if augment {
        if config.rotate_reference {
            let rotation = random_rotation(model.quirks.euler_reference_rotation, rng);
            rotate_reference(&mut reference.points, &mut pose, &rotation);
        }
        shift_query(&mut query.points, &mut pose, config, rng);
    }
    Ok(AugmentedPair { query, reference, radius, pose })
}

/// Uniform on SO(3), or (quirk) Rx Ry Rz of three uniform angles.
fn random_rotation(euler: bool, rng: &mut ChaCha8Rng) -> Matrix3<f64> {
    if euler {
        let mut about =
            |axis: Vector3<f64>| Rotation3::new(axis * rng.random_range(0.0..std::f64::consts::TAU));
        return *(about(Vector3::x()) * about(Vector3::y()) * about(Vector3::z())).matrix();
    }
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let q = nalgebra::Quaternion::new(normal(), normal(), normal(), normal());
    *UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix()
}

/// p becomes R^T p and the pose's rotation R_pose R.
fn rotate_reference(points: &mut [[f32; 3]], pose: &mut Pose, rotation: &Matrix3<f64>) {
    let inverse = Pose::new(rotation.transpose(), Vector3::zeros());
    points.iter_mut().for_each(|p| *p = inverse.transform_f32(p));
    pose.rotation *= rotation;
}

/// Moves all query points and the pose by one shift, and every point by its own noise.
fn shift_query(points: &mut [[f32; 3]], pose: &mut Pose, config: &AugmentationConfig, rng: &mut ChaCha8Rng) {
    let bound = config.query_shift;
    let shift = Vector3::from_fn(|_, _| rng.random_range(-bound..=bound));
    pose.translation += shift;
    for p in points {
        for (axis, value) in p.iter_mut().enumerate() {
            let noise: f64 = StandardNormal.sample(rng);
            *value += (shift[axis] + noise * config.query_noise) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pose_follows_the_points() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let truth = Pose::new(random_rotation(false, &mut rng), Vector3::new(0.1, -0.3, 0.6));
        for euler in [false, true] {
            let mut reference: Vec<[f32; 3]> =
                (0..50).map(|_| std::array::from_fn(|_| rng.random_range(-0.1..0.1))).collect();
            let mut query: Vec<[f32; 3]> = reference.iter().map(|p| truth.transform_f32(p)).collect();
            let mut pose = truth;
            rotate_reference(&mut reference, &mut pose, &random_rotation(euler, &mut rng));
            let config = AugmentationConfig { query_noise: 0.0, ..AugmentationConfig::default() };
            shift_query(&mut query, &mut pose, &config, &mut rng);
            assert!(pose.translation_distance(&truth) <= 0.01 * 3f64.sqrt());
            assert!(pose.translation_distance(&truth) > 0.0);
            for (p, q) in reference.iter().zip(&query) {
                let moved = pose.transform_f32(p);
                assert!((0..3).all(|i| (moved[i] - q[i]).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn rotations_are_uniform() {
        // The mean of a uniform rotation's entries is 0 with deviation sqrt(1/3 / n); the mean trace of Rx Ry Rz of
        // uniform angles is 0 too, but its entry (0, 2) = sin(y) has variance 1/2 instead of 1/3.
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let n = 20_000;
        let variance = |euler: bool, rng: &mut ChaCha8Rng| {
            (0..n).map(|_| random_rotation(euler, rng)[(0, 2)].powi(2)).sum::<f64>() / n as f64
        };
        assert!((variance(false, &mut rng) - 1.0 / 3.0).abs() < 0.01);
        assert!((variance(true, &mut rng) - 0.5).abs() < 0.01);
    }

    #[test]
    fn noise_has_its_deviation() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let config = AugmentationConfig { query_shift: 0.0, ..AugmentationConfig::default() };
        let mut points = vec![[0.0f32; 3]; 5000];
        shift_query(&mut points, &mut Pose::identity(), &config, &mut rng);
        let values = points.as_flattened();
        let std = (values.iter().map(|v| (*v as f64).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
        assert!((std - 1e-3).abs() < 3e-5, "{std}");
    }
}
