//! Smooth random fields: noise and holes of depth cameras are not independent from pixel to pixel (Barron & Malik 2013).

use rand_chacha::ChaCha8Rng;

use crate::synth::random::Draw;

/// Smooth noise of unit variance, correlated over about `length` pixels.
pub(super) fn correlated(w: usize, h: usize, length: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
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
pub(super) fn normal_cdf(x: f32) -> f32 {
    1.0 / (1.0 + (-1.702 * x).exp())
}
