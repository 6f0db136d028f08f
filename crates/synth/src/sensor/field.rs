//! Smooth random fields: noise and holes of depth cameras are not independent from pixel to pixel (Barron & Malik 2013).

use rand_chacha::ChaCha8Rng;

use crate::random::Draw;

/// Smooth noise of unit variance, correlated over about `length` pixels.
pub(super) fn correlated(w: usize, h: usize, length: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let spacing = length.max(1.0);
    let (cols, rows) = ((w as f32 / spacing) as usize + 3, (h as f32 / spacing) as usize + 3);
    let lattice: Vec<f32> = (0..cols * rows).map(|_| rng.normal()).collect();
    let across: Vec<(usize, [f32; 2])> = (0..w).map(|col| weights(col as f32 / spacing)).collect();
    let mut field = Vec::with_capacity(w * h);
    let mut line = vec![0.0; cols];
    for row in 0..h {
        let (r, [near, far]) = weights(row as f32 / spacing);
        let (above, below) = (&lattice[r * cols..][..cols], &lattice[(r + 1) * cols..][..cols]);
        for (value, (a, b)) in line.iter_mut().zip(above.iter().zip(below)) {
            *value = near * a + far * b;
        }
        field.extend(across.iter().map(|&(c, [near, far])| near * line[c] + far * line[c + 1]));
    }
    field
}

/// Lattice cell and the weights of its two ends; interpolation shrinks the variance by the sum of squared weights, which
/// is made up for.
fn weights(place: f32) -> (usize, [f32; 2]) {
    let cell = place as usize;
    let t = place - cell as f32;
    let scale = 1.0 / ((1.0 - t) * (1.0 - t) + t * t).sqrt();
    (cell, [(1.0 - t) * scale, t * scale])
}

/// Distribution function of the standard normal (logistic approximation, error below 0.01).
pub(super) fn normal_cdf(x: f32) -> f32 {
    1.0 / (1.0 + (-1.702 * x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Domain, stream};

    #[test]
    fn fields_have_unit_variance_and_fall_off_with_distance() {
        let (w, h) = (400, 300);
        let field = correlated(w, h, 6.0, &mut stream(3, Domain::Sensor, 0));
        let product = |shift: usize| {
            let pairs = (0..w * h - shift).map(|i| f64::from(field[i] * field[i + shift]));
            pairs.sum::<f64>() / (w * h - shift) as f64
        };
        assert!((product(0) - 1.0).abs() < 0.06, "{}", product(0));
        assert!(product(1) > 0.9 && product(12).abs() < 0.06, "{} {}", product(1), product(12));
    }
}
