//! Time of flight: the phase of modulated light.
//!
//! Noise falls with the amplitude that comes back, hence with reflectance, distance and angle (Lindner & Kolb 2007;
//! Fankhauser et al. 2015 and Sarbolandi, Lefloch & Kolb 2015 measure 1 to 2 mm at 1 m for the Kinect v2, Tölgyessy et
//! al. 2021 about 1 mm for the Azure Kinect). Pixels across an edge add the signals of both surfaces and report a depth
//! in between, unless a filter drops them. Systematic errors of a few millimetres: wiggling with the distance, and dark
//! against bright surfaces (Lindner & Kolb 2007). Light source and lens are side by side, so nothing is occluded.

use rand_chacha::ChaCha8Rng;
use unopose_core::{config::SensorConfig, frame::DepthMap};
use unopose_dataset::render::Rendering;

use super::{
    depth_sensor::{DepthSensor, REFERENCE_WIDTH, reflection_loss, spots},
    field::{correlated, normal_cdf},
};
use crate::random::Draw;

/// Distance over which the wiggling repeats: a quarter of the wavelength at about 50 MHz, metres.
const WIGGLE_PERIOD: f32 = 0.75;
/// Reflectance and incidence that `tof_noise` refers to.
const USUAL_REFLECTANCE: f32 = 0.3;
/// Signals farther apart than this are mixed, metres.
const MIXED: f32 = 0.02;

impl DepthSensor {
    /// Depth of a time-of-flight camera, metres; 0 where nothing was measured.
    pub(super) fn measure_phase(
        &self,
        view: &Rendering,
        brightness: &[f32],
        config: &SensorConfig,
        rng: &mut ChaCha8Rng,
    ) -> DepthMap {
        let exact = &view.depth;
        let (w, h) = (exact.width as usize, exact.height as usize);
        let scale = w as f32 / REFERENCE_WIDTH;
        let grain = correlated(w, h, 1.6 * scale, rng);
        let hole_blob = spots(w, h, self.hole_length * scale, rng);
        let [wiggle, shade] = self.offsets.map(|o| o * config.tof_offset);
        let mut measured = DepthMap::zeros(exact.width, exact.height);
        for i in 0..w * h {
            let (row, col) = (i / w, i % w);
            let own = exact.data[i];
            let (dice, mix) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0));
            // The pixel's footprint: itself and a share of its neighbours, weighted by what they send back.
            let amplitude = |k: usize| {
                let (albedo, z) = (view.albedo[k].max(0.02), exact.data[k].max(0.1));
                albedo * view.incidence[k].max(0.05) / (z * z)
            };
            let neighbours = [
                (col + 1 < w).then(|| i + 1),
                (col > 0).then(|| i - 1),
                (row + 1 < h).then(|| i + w),
                (row > 0).then(|| i - w),
            ];
            let (mut sum, mut weight) = (own * amplitude(i), amplitude(i));
            let mut mixed = false;
            for k in neighbours.into_iter().flatten() {
                let share = 0.15 * mix * amplitude(k);
                sum += share * exact.data[k];
                weight += share;
                mixed |= (exact.data[k] - own).abs() > MIXED;
            }
            let mut z = if mixed { sum / weight } else { own };
            let incidence = view.incidence[i].max(0.0);
            let reflectance = view.albedo[i].max(0.02);
            let mut loss = reflection_loss(view, i, brightness[i], config);
            if mixed {
                loss = loss.max(config.edge_loss * self.edges);
            }
            // Light comes back from flatter angles than a pattern can be matched at.
            let grazing = 0.5 * config.grazing_cos;
            if incidence < grazing {
                loss = loss.max(1.0 - incidence / grazing);
            }
            let rank = || normal_cdf(hole_blob[i]) * (1.0 - self.hole_grain) + dice * self.hole_grain;
            let in_range = z > config.range[0] && z < config.range[1];
            if (loss > 0.0 && rank() < loss) || dice < config.speckle_loss || !in_range {
                continue;
            }
            let [constant, squared] = config.tof_noise;
            let weak = (USUAL_REFLECTANCE / (reflectance * incidence.max(0.1))).sqrt().clamp(0.5, 5.0);
            z += self.gain * (constant + squared * own * own) * weak * grain[i];
            z += wiggle * (std::f32::consts::TAU * own / WIGGLE_PERIOD).sin();
            z += shade * (1.0 - reflectance / USUAL_REFLECTANCE).clamp(-1.0, 1.0);
            // Whole millimetres, as these cameras hand them out.
            measured.data[i] = (z * 1000.0).round() / 1000.0;
        }
        measured
    }
}
