//! Depth camera model: a structured-light or stereo sensor that measures disparity.
//!
//! Axial noise is disparity noise, so it grows with z^2 (Khoshelham & Elberink 2012, sigma_z = m sigma_d z^2; Nguyen,
//! Izadi & Lovell 2012 measure 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2 for the Kinect); disparity is quantised to a fraction
//! of a pixel (1/8 px, Khoshelham & Elberink); edges move by about a pixel (lateral noise 0.8 px, Nguyen et al.); holes
//! appear where the second view is occluded, at grazing angles, on dark and shiny surfaces (Handa et al. 2014; Barron &
//! Malik 2013 for the correlated noise).

use rand_chacha::ChaCha8Rng;

use super::random::Draw;
use crate::{config::SensorConfig, frame::DepthMap, render::Rendering};

/// Width that pixel lengths in [`SensorConfig`] refer to.
const REFERENCE_WIDTH: f32 = 640.0;

/// What stays the same over the views of a scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthSensor {
    baseline: f32,
    gain: f32,
    /// +1: the second camera is to the right.
    side: f32,
}

impl DepthSensor {
    pub fn draw(config: &SensorConfig, rng: &mut ChaCha8Rng) -> Self {
        Self {
            baseline: rng.between(config.baseline[0], config.baseline[1]),
            gain: rng.log_between(config.noise_gain[0], config.noise_gain[1]),
            side: if rng.chance(0.5) { 1.0 } else { -1.0 },
        }
    }

    /// Measured depth, 0 where nothing was measured. `focal` in pixels; `brightness` is the image's luminance 0..1.
    pub fn measure(
        &self,
        view: &Rendering,
        focal: f32,
        brightness: &[f32],
        config: &SensorConfig,
        rng: &mut ChaCha8Rng,
    ) -> DepthMap {
        let exact = &view.depth;
        let (w, h) = (exact.width as usize, exact.height as usize);
        // Pixels of this image per reference pixel.
        let scale = w as f32 / REFERENCE_WIDTH;
        let mut field = |length: f32| correlated(w, h, length * scale, rng);
        let [fine, medium, coarse] = [field(2.0), field(5.0), field(30.0)];
        let (shift_x, shift_y, hole_blob, edge_blob) = (field(8.0), field(8.0), field(5.0), field(4.0));
        let focal_baseline = focal * self.baseline;
        let disparity = |z: f32| focal_baseline / z;
        let hidden = self.occluded(exact, focal_baseline);
        let mut measured = DepthMap::zeros(exact.width, exact.height);
        for row in 0..h {
            for col in 0..w {
                let i = row * w + col;
                let jitter = config.edge_jitter * scale;
                let (dx, dy) = (shift_x[i] * jitter, shift_y[i] * jitter);
                let at = |x: f32, y: f32| {
                    let c = (col as f32 + x).round().clamp(0.0, (w - 1) as f32) as usize;
                    let r = (row as f32 + y).round().clamp(0.0, (h - 1) as f32) as usize;
                    r * w + c
                };
                let own = exact.data[i];
                let moved = exact.data[at(dx, dy)];
                // Only edges move; along a smooth surface the sensor sees its own point.
                let jump = |z: f32| (disparity(z) - disparity(own)).abs() > 0.7 * scale.max(0.4);
                let mut z = if jump(moved) { moved } else { own };
                let reach = (2.5 * scale).max(1.0);
                let beside = [(reach, 0.0), (-reach, 0.0), (0.0, reach), (0.0, -reach)]
                    .map(|(x, y)| exact.data[at(x, y)])
                    .into_iter()
                    .find(|&n| jump(n));
                let (dice, mix) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0));
                let mut loss = 0.0f32;
                if let Some(other) = beside {
                    loss = config.edge_loss;
                    if mix < config.flying {
                        z = own + (other - own) * dice;
                    }
                }
                let incidence = view.incidence[i];
                if incidence < config.grazing_cos {
                    loss = loss.max(1.0 - incidence / config.grazing_cos);
                }
                if view.albedo[i] < 0.03 || brightness[i] < 0.04 {
                    loss = loss.max(config.dark_loss);
                }
                let finish = &view.finish[i];
                let mirror = (1.0 - finish.roughness) * (0.4 + 0.6 * finish.metallic);
                if brightness[i] > 0.97 || mirror * incidence > 0.45 {
                    loss = loss.max(config.shiny_loss);
                }
                // Holes come in blobs: a smooth field decides most of them.
                let blob = if beside.is_some() { edge_blob[i] } else { hole_blob[i] };
                let rank = normal_cdf(blob) * 0.75 + mix * 0.25;
                let lost = rank < loss || dice < config.speckle_loss || hidden[at(dx, dy)];
                let in_range = z > config.range[0] && z < config.range[1];
                if lost || !in_range {
                    continue;
                }
                let [a, b, c] = config.disparity_noise;
                let noise = self.gain * scale * (a * fine[i] + b * medium[i] + c * coarse[i]);
                let mut d = disparity(z) + noise;
                if config.disparity_steps > 0.0 {
                    let steps = config.disparity_steps / scale;
                    // Dithered by the sub-pixel interpolation of the matcher, so steps are not sharp.
                    d = ((d * steps) + 0.5 * (rng.between(0.0, 1.0) - 0.5)).round() / steps;
                }
                measured.data[i] = if d > 0.0 { focal_baseline / d } else { 0.0 };
            }
        }
        measured
    }

    /// Pixels that the second camera does not see.
    fn occluded(&self, depth: &DepthMap, focal_baseline: f32) -> Vec<bool> {
        let (w, h) = (depth.width as usize, depth.height as usize);
        let mut hidden = vec![false; w * h];
        for row in 0..h {
            let line = &depth.data[row * w..(row + 1) * w];
            // In the second image a pixel lies at col - side * disparity; walking from the far side, a pixel is hidden
            // when a nearer one already covers that place.
            let mut covered = f32::MAX;
            for k in 0..w {
                let col = if self.side > 0.0 { w - 1 - k } else { k };
                let d = focal_baseline / line[col].max(1e-3);
                let place = self.side * col as f32 - d;
                if place > covered + 0.8 {
                    hidden[row * w + col] = true;
                } else {
                    covered = covered.min(place);
                }
            }
        }
        hidden
    }
}

/// Smooth noise of unit variance, correlated over about `length` pixels.
fn correlated(w: usize, h: usize, length: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let spacing = length.max(1.0);
    let (cols, rows) = ((w as f32 / spacing) as usize + 3, (h as f32 / spacing) as usize + 3);
    let lattice: Vec<f32> = (0..cols * rows).map(|_| rng.normal()).collect();
    let mut field = Vec::with_capacity(w * h);
    for row in 0..h {
        let y = row as f32 / spacing;
        let (r, fy) = (y as usize, y.fract());
        for col in 0..w {
            let x = col as f32 / spacing;
            let (c, fx) = (x as usize, x.fract());
            let at = |dr: usize, dc: usize| lattice[(r + dr) * cols + c + dc];
            let (wx, wy) = ([1.0 - fx, fx], [1.0 - fy, fy]);
            let sum =
                wy[0] * (wx[0] * at(0, 0) + wx[1] * at(0, 1)) + wy[1] * (wx[0] * at(1, 0) + wx[1] * at(1, 1));
            // Interpolation shrinks the variance by the sum of squared weights.
            let variance = (wx[0] * wx[0] + wx[1] * wx[1]) * (wy[0] * wy[0] + wy[1] * wy[1]);
            field.push(sum / variance.sqrt());
        }
    }
    field
}

/// Distribution function of the standard normal (logistic approximation, error below 0.01).
fn normal_cdf(x: f32) -> f32 {
    1.0 / (1.0 + (-1.702 * x).exp())
}
