//! What the models of depth cameras share: the parameters of one camera, and where measurements fail.

use rand_chacha::ChaCha8Rng;
use unopose_core::config::SensorConfig;
use unopose_dataset::render::Rendering;

use super::field::correlated;
use crate::random::Draw;

/// Width that pixel lengths in [`SensorConfig`] refer to.
pub(super) const REFERENCE_WIDTH: f32 = 640.0;

/// The principle of measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Style {
    StructuredLight,
    Stereo,
    TimeOfFlight,
}

/// A depth camera, the same for all views of a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthSensor {
    pub style: Style,
    /// Distance between the two viewpoints, metres.
    pub(super) baseline: f32,
    /// Factor on the noise.
    pub(super) gain: f32,
    /// +1: the second camera is to the right.
    pub(super) side: f32,
    /// Size of the spots in which measurements fail, pixels of the reference width.
    pub(super) hole_length: f32,
    /// Share of the failures that are single pixels.
    pub(super) hole_grain: f32,
    /// Share of `edge_loss` that this sensor shows: some fill or filter their edges.
    pub(super) edges: f32,
    /// Time of flight: offset of dark against bright surfaces and amplitude of the wiggling, -1..1 of the limit.
    pub(super) offsets: [f32; 2],
}

impl DepthSensor {
    /// The sensor of a scene.
    pub fn draw(config: &SensorConfig, rng: &mut ChaCha8Rng) -> Self {
        let (baseline, gain, side) = (
            rng.between(config.baseline[0], config.baseline[1]),
            rng.log_between(config.noise_gain[0], config.noise_gain[1]),
            if rng.chance(0.5) { 1.0 } else { -1.0 },
        );
        let dice = rng.between(0.0, 1.0);
        let style = if dice < config.stereo {
            Style::Stereo
        } else if dice < config.stereo + config.time_of_flight {
            Style::TimeOfFlight
        } else {
            Style::StructuredLight
        };
        Self {
            style,
            baseline,
            gain,
            side,
            hole_length: rng.log_between(4.0, 18.0),
            hole_grain: rng.between(0.0, 0.3),
            edges: if rng.chance(0.3) { rng.between(0.0, 0.2) } else { rng.between(0.3, 1.6) },
            offsets: [rng.between(-1.0, 1.0), rng.between(-1.0, 1.0)],
        }
    }
}

/// Noise whose low values are where measurements fail: spots of two sizes.
pub(super) fn spots(w: usize, h: usize, length: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let (mut large, small) = (correlated(w, h, length, rng), correlated(w, h, 0.3 * length, rng));
    large.iter_mut().zip(small).for_each(|(a, b)| *a = 0.8 * *a + 0.6 * b);
    large
}

/// Chance that a surface returns too little light or too much of it.
pub(super) fn reflection_loss(view: &Rendering, i: usize, brightness: f32, config: &SensorConfig) -> f32 {
    let mut loss = 0.0f32;
    if view.albedo[i] < 0.03 || brightness < 0.04 {
        loss = config.dark_loss;
    }
    let finish = &view.finish[i];
    let mirror = (1.0 - finish.roughness) * (0.4 + 0.6 * finish.metallic);
    if brightness > 0.97 || mirror * view.incidence[i] > 0.45 {
        loss = loss.max(config.shiny_loss);
    }
    loss
}
