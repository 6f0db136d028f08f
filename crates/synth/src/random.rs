//! Random streams: every item draws from its own generator, so that results depend on no order of execution.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream is for; part of its seed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Domain {
    /// Size and shape of an object; the index is its id.
    Shape = 1,
    /// Colours, prints and finish of an object; the index is its id.
    Look = 2,
    /// Which objects a shard draws from; the index is the shard.
    Pool = 3,
    /// Arrangement, light and surroundings; the index is the scene, counted over all shards.
    Scene = 4,
    /// Camera, exposure and noise; the index is the view, counted over all scenes.
    View = 5,
    /// Parameters of the depth camera; the index is the scene, counted over all shards.
    Sensor = 6,
    /// Which objects are packages, and their prints; the index is the object's id.
    Print = 7,
}

/// The generator of item `index` of a domain.
pub(super) fn stream(seed: u64, domain: Domain, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (domain as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    rng.set_stream(index);
    rng
}

/// Short forms of the draws used throughout this crate.
pub(super) trait Draw {
    /// Uniform in [low, high); `low` when the range is empty.
    fn between(&mut self, low: f32, high: f32) -> f32;
    /// Log-uniform in [low, high), both above 0.
    fn log_between(&mut self, low: f32, high: f32) -> f32;
    /// Uniform integer in [low, high].
    fn count(&mut self, low: usize, high: usize) -> usize;
    /// True with this probability.
    fn chance(&mut self, probability: f32) -> bool;
    /// Standard normal.
    fn normal(&mut self) -> f32;
    /// One of the items, which must not be empty; all are equally likely.
    fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T;
    /// Uniform on the unit sphere.
    fn unit_vector(&mut self) -> nalgebra::Vector3<f32>;
}

impl<R: Rng> Draw for R {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low).max(0.0) * self.random::<f32>()
    }

    fn log_between(&mut self, low: f32, high: f32) -> f32 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn count(&mut self, low: usize, high: usize) -> usize {
        if high > low { self.random_range(low..=high) } else { low }
    }

    fn chance(&mut self, probability: f32) -> bool {
        self.random::<f32>() < probability
    }

    fn normal(&mut self) -> f32 {
        self.sample(rand_distr::StandardNormal)
    }

    fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.random_range(0..items.len())]
    }

    fn unit_vector(&mut self) -> nalgebra::Vector3<f32> {
        let z = self.between(-1.0, 1.0);
        let (s, c) = self.between(0.0, std::f32::consts::TAU).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        nalgebra::Vector3::new(r * c, r * s, z)
    }
}
