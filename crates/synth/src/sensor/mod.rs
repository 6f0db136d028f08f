//! Depth camera models: structured light, stereo and time of flight.
//!
//! Structured light and stereo measure disparity ([`disparity`]), a time-of-flight camera measures a phase
//! ([`time_of_flight`]). All leave holes on grazing, dark and shiny surfaces, and err along depth edges. Parameters are
//! in [`SensorConfig`]; the sources stand with each model.

mod depth_sensor;
mod disparity;
mod field;
mod time_of_flight;

pub(super) use depth_sensor::DepthSensor;

use rand_chacha::ChaCha8Rng;
use unopose_core::{config::SensorConfig, frame::DepthMap};
use unopose_dataset::render::Rendering;

use depth_sensor::Style;

impl DepthSensor {
    /// Measured depth, 0 where nothing was measured. `focal` in pixels; `brightness` is the image's luminance 0..1.
    pub fn measure(
        &self,
        view: &Rendering,
        focal: f32,
        brightness: &[f32],
        config: &SensorConfig,
        rng: &mut ChaCha8Rng,
    ) -> DepthMap {
        match self.style {
            Style::TimeOfFlight => self.measure_phase(view, brightness, config, rng),
            _ => self.measure_disparity(view, focal, brightness, config, rng),
        }
    }
}

#[cfg(test)]
mod tests;
