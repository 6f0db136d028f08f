//! Noisy initial poses for the fine stage in training (`docs/network.md`, section 7).

use nalgebra::{Rotation3, Vector3};
use rand::{Rng, seq::IndexedRandom};
use rand_distr::{Distribution, StandardNormal};
use unopose_core::{config::PoseNoiseConfig, geometry::Pose};

/// Standard normal draws and the standard deviation of one noisy pose.
#[derive(Clone, Copy, Debug)]
pub struct PoseNoise {
    /// About z, x and y (the order of application) before clipping, degrees.
    pub angles_deg: [f64; 3],
    /// Before clipping, radii.
    pub translation: [f64; 3],
}

/// One of the configured rotation deviations, degrees; 0 when there is none.
pub fn draw_rotation_std(config: &PoseNoiseConfig, rng: &mut impl Rng) -> f64 {
    config.rotation_std_deg.choose(rng).copied().unwrap_or(0.0)
}

impl PoseNoise {
    /// Per-axis normal draws.
    pub(super) fn draw(config: &PoseNoiseConfig, rotation_std_deg: f64, rng: &mut impl Rng) -> Self {
        let mut normal = |std: f64| -> f64 {
            let unit: f64 = StandardNormal.sample(rng);
            unit * std
        };
        let angles_deg = std::array::from_fn(|_| normal(rotation_std_deg));
        Self { angles_deg, translation: std::array::from_fn(|_| normal(config.translation_std)) }
    }

    /// `R Rz Rx Ry` and `t + noise`, both clipped; `clamp_z` keeps t_z at least 1e-6 (quirk of the release).
    pub fn apply(&self, pose: &Pose, config: &PoseNoiseConfig, clamp_z: bool) -> Pose {
        let angle = |i: usize| {
            self.angles_deg[i].clamp(-config.max_rotation_deg, config.max_rotation_deg).to_radians()
        };
        let about = |axis: Vector3<f64>, i: usize| Rotation3::new(axis * angle(i));
        let noise = about(Vector3::z(), 0) * about(Vector3::x(), 1) * about(Vector3::y(), 2);
        let clipped =
            Vector3::from(self.translation.map(|t| t.clamp(-config.max_translation, config.max_translation)));
        let mut translation = pose.translation + clipped;
        if clamp_z {
            translation.z = translation.z.max(1e-6);
        }
        Pose::new(pose.rotation * noise.matrix(), translation)
    }
}
