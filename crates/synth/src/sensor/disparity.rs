//! Structured light and stereo: a matched pattern or picture, two viewpoints.
//!
//! Axial noise is disparity noise, so it grows with z² (Khoshelham & Elberink 2012, sigma_z = m sigma_d z²; Nguyen,
//! Izadi & Lovell 2012 measure 1.2 mm + 1.9 mm/m² (z - 0.4 m)² for the Kinect; Keselman et al. 2017 0.05 to 0.1 px for
//! the RealSense). Disparity is quantised, 1/8 px in the Kinect (Khoshelham & Elberink), 1/32 px in the RealSense
//! (Keselman et al.). Edges move by about a pixel (lateral noise 0.8 px, Nguyen et al.); block matching makes the
//! foreground wider. Holes appear where the second view is occluded, at grazing angles, on dark and shiny surfaces
//! (Handa et al. 2014), for stereo also where nothing can be matched.

use rand_chacha::ChaCha8Rng;
use unopose_core::{config::SensorConfig, frame::DepthMap};
use unopose_dataset::render::Rendering;

use super::{
    depth_sensor::{DepthSensor, REFERENCE_WIDTH, Style, reflection_loss, spots},
    field::{correlated, normal_cdf},
};
use crate::random::Draw;

/// What tells stereo from structured light: gains of the three noise terms, of the disparity steps and of the edges'
/// displacement.
struct Matcher {
    noise: [f32; 3],
    steps: f32,
    edges: f32,
    /// The nearer surface wins along edges.
    fattens: bool,
}

impl Matcher {
    fn of(style: Style) -> Self {
        match style {
            Style::Stereo => Self { noise: [0.35, 1.5, 1.0], steps: 4.0, edges: 1.3, fattens: true },
            _ => Self { noise: [1.0; 3], steps: 1.0, edges: 1.0, fattens: false },
        }
    }
}

impl DepthSensor {
    /// Depth of structured light or stereo, metres; 0 where nothing was measured.
    pub(super) fn measure_disparity(
        &self,
        view: &Rendering,
        focal: f32,
        brightness: &[f32],
        config: &SensorConfig,
        rng: &mut ChaCha8Rng,
    ) -> DepthMap {
        let exact = &view.depth;
        let (w, h) = (exact.width as usize, exact.height as usize);
        let matcher = Matcher::of(self.style);
        // Pixels of this image per reference pixel.
        let scale = w as f32 / REFERENCE_WIDTH;
        let mut field = |length: f32| correlated(w, h, length * scale, rng);
        let [fine, medium, coarse] = [field(2.0), field(5.0), field(30.0)];
        let (shift_x, shift_y, edge_blob) = (field(8.0), field(8.0), field(4.0));
        let hole_blob = spots(w, h, self.hole_length * scale, rng);
        let focal_baseline = focal * self.baseline;
        let disparity = |z: f32| focal_baseline / z;
        let hidden = self.occluded(exact, focal_baseline);
        let mut measured = DepthMap::zeros(exact.width, exact.height);
        let reach = (2.5 * scale).max(1.0).round() as usize;
        for row in 0..h {
            for col in 0..w {
                let i = row * w + col;
                let jitter = config.edge_jitter * matcher.edges * scale;
                let (dx, dy) = (shift_x[i] * jitter, shift_y[i] * jitter);
                // Half a pixel more and cut off is rounded, without a call into libm on plain x86-64.
                let shifted =
                    |from: usize, by: f32, n: usize| ((from as f32 + by + 0.5).max(0.0) as usize).min(n - 1);
                let source = shifted(row, dy, h) * w + shifted(col, dx, w);
                let own = exact.data[i];
                let moved = exact.data[source];
                // Only edges move; along a smooth surface the sensor sees its own point.
                let jump = |z: f32| (disparity(z) - disparity(own)).abs() > 0.7 * scale.max(0.4);
                let mut z = if jump(moved) && (!matcher.fattens || moved < own) { moved } else { own };
                let beside = [
                    row * w + (col + reach).min(w - 1),
                    row * w + col.saturating_sub(reach),
                    (row + reach).min(h - 1) * w + col,
                    row.saturating_sub(reach) * w + col,
                ]
                .map(|k| exact.data[k])
                .into_iter()
                .find(|&n| jump(n));
                let (dice, mix) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0));
                let mut loss = reflection_loss(view, i, brightness[i], config);
                if let Some(other) = beside {
                    loss = loss.max(config.edge_loss * self.edges);
                    if mix < config.flying {
                        z = own + (other - own) * dice;
                    }
                }
                let incidence = view.incidence[i];
                if incidence < config.grazing_cos {
                    loss = loss.max(1.0 - incidence / config.grazing_cos);
                }
                // A window without contrast: more noise, sometimes no match.
                let blank = match matcher.fattens {
                    true => flatness(brightness, w, h, row, col),
                    false => 0.0,
                };
                loss = loss.max(0.06 * blank);
                // Holes come in blobs: a smooth field decides most of them.
                let blob = if beside.is_some() { edge_blob[i] } else { hole_blob[i] };
                let rank = || normal_cdf(blob) * (1.0 - self.hole_grain) + mix * self.hole_grain;
                let failed = loss > 0.0 && rank() < loss;
                let lost = failed || dice < config.speckle_loss || hidden[source];
                let in_range = z > config.range[0] && z < config.range[1];
                if lost || !in_range {
                    continue;
                }
                let [a, b, c] = config.disparity_noise;
                let [ga, gb, gc] = matcher.noise;
                let sum = ga * a * fine[i] + gb * b * medium[i] + gc * c * coarse[i];
                let mut d = disparity(z) + self.gain * scale * (1.0 + blank) * sum;
                if config.disparity_steps > 0.0 {
                    let steps = config.disparity_steps * matcher.steps / scale;
                    // Dithered by the sub-pixel interpolation of the matcher, so steps are not sharp.
                    let step = d * steps + 0.5 * (rng.between(0.0, 1.0) - 0.5);
                    d = (step + 0.5) as i32 as f32 / steps;
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

/// 1 where the picture does not change within a few pixels, 0 where it changes by 3 % or more.
fn flatness(brightness: &[f32], w: usize, h: usize, row: usize, col: usize) -> f32 {
    let at = |r: usize, c: usize| brightness[r.min(h - 1) * w + c.min(w - 1)];
    let here = at(row, col);
    let steps =
        [at(row, col + 3), at(row + 3, col), at(row, col.saturating_sub(3)), at(row.saturating_sub(3), col)];
    let change = steps.into_iter().map(|b| (b - here).abs()).fold(0.0, f32::max);
    (1.0 - change / 0.03).max(0.0)
}
