//! Lens distortion of Brown and Conrady with a rational radial part, as OpenCV and ROS write it.

/// From the ideal to the distorted image on the plane at depth 1. With `s = x^2 + y^2` and
/// `f = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)`:
///
/// `x' = x f + 2 p1 x y + p2 (s + 2 x^2)`, `y' = y f + p1 (s + 2 y^2) + 2 p2 x y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// k1 to k6, the last three 0 in the model that is called `plumb_bob`.
    pub radial: [f64; 6],
    /// p1 and p2.
    pub tangential: [f64; 2],
}

/// Steps in which [`Distortion::fold_radius`] walks outwards.
const FOLD_STEPS: u32 = 2000;

impl Distortion {
    /// Where the ideal point `(x, y)` is in the distorted image, both at depth 1.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (s, [p1, p2]) = (x * x + y * y, self.tangential);
        let f = self.radial_factor(s);
        [x * f + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x), y * f + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y]
    }

    /// The smallest radius up to `limit` beyond which the radial part comes back towards the centre: the model was fitted
    /// inside it and means nothing outside. Infinite where there is none.
    pub fn fold_radius(&self, limit: f64) -> f64 {
        let mut last = [0.0, 0.0];
        for step in 1..=FOLD_STEPS {
            let radius = limit * f64::from(step) / f64::from(FOLD_STEPS);
            let distorted = radius * self.radial_factor(radius * radius);
            // Not a number counts as a fold, too.
            if !(distorted > last[1] && distorted.is_finite()) {
                return last[0];
            }
            last = [radius, distorted];
        }
        f64::INFINITY
    }

    fn radial_factor(&self, s: f64) -> f64 {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        (1.0 + s * (k1 + s * (k2 + s * k3))) / (1.0 + s * (k4 + s * (k5 + s * k6)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_by_hand() {
        let plumb_bob = Distortion { radial: [0.1, -0.2, 0.3, 0.0, 0.0, 0.0], tangential: [0.01, -0.02] };
        // s = 0.25, f = 1 + 0.025 - 0.0125 + 0.0046875 = 1.0171875.
        let [x, y] = plumb_bob.distort([0.3, 0.4]);
        let expected = [
            0.3 * 1.0171875 + 0.02 * 0.12 - 0.02 * (0.25 + 0.18),
            0.4 * 1.0171875 + 0.01 * (0.25 + 0.32) - 0.04 * 0.12,
        ];
        assert!((x - expected[0]).abs() < 1e-12 && (y - expected[1]).abs() < 1e-12);
        // s = 1: (1 + 0.5) / (1 + 0.2 + 0.1 + 0.2) = 1.
        let rational = Distortion { radial: [0.5, 0.0, 0.0, 0.2, 0.1, 0.2], tangential: [0.0; 2] };
        assert!((rational.distort([0.6, 0.8])[0] - 0.6).abs() < 1e-12);
    }

    #[test]
    fn a_fold_is_found_where_the_derivative_is_zero() {
        let barrel = Distortion { radial: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0], tangential: [0.0; 2] };
        // d/dr (r - 0.3 r^3) = 0 at r = 1 / sqrt(0.9).
        assert!((barrel.fold_radius(2.0) - 1.0 / 0.9_f64.sqrt()).abs() < 2e-3);
        assert_eq!(barrel.fold_radius(1.0), f64::INFINITY);
        let absurd = Distortion { radial: [f64::MAX; 6], tangential: [0.0; 2] };
        assert_eq!(absurd.fold_radius(1.0), 0.0);
    }
}
