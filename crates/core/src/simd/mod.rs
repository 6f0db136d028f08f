//! Arithmetic on slices for the widest vectors of the CPU at hand.
//!
//! The functions here are written so that the compiler can turn loops over them into vector code; `vectorised`
//! compiles a loop for several instruction sets and picks one at run time.

mod panel;
mod product;
mod row_products;

pub use panel::{PANEL, add_panel, panels_of_rows};
pub use product::{add_product, add_transposed_product, map_rows};
pub use row_products::row_products;

/// Computes an expression in a version compiled for this CPU (AVX-512, AVX2 or the target's baseline).
///
/// Only code that is inlined is compiled anew: the expression itself, loops over slices in it, and functions and closures
/// marked `#[inline(always)]`; anything else runs as the target's baseline.
#[macro_export]
macro_rules! vectorised {
    ($work:expr) => {
        // A closure that is not marked may be left out of the versions when it is long.
        $crate::simd::dispatch(
            #[inline(always)]
            || $work,
        )
    };
}
pub use vectorised;

/// For `vectorised`. The bound makes a closure's only body that of `FnOnce`; one whose body is that of `Fn` would be called
/// by way of a function of the baseline.
#[inline(always)]
pub fn dispatch<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// exp for arguments up to 0, relative error below 2e-7, 0 below -87. Unlike the library's it vectorises.
#[inline(always)]
pub fn exp_of_negative(x: f32) -> f32 {
    let clamped = if x < -87.0 { -87.0 } else { x };
    // Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = clamped.mul_add(std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let r = n.mul_add(2.121_944_4e-4, n.mul_add(-0.693_359_4, clamped));
    let p = 1.987_569_1e-4f32.mul_add(r, 1.398_2e-3);
    let p = p.mul_add(r, 8.333_452e-3);
    let p = p.mul_add(r, 4.166_579_6e-2);
    let p = p.mul_add(r, 1.666_666_5e-1);
    let p = p.mul_add(r, 0.5);
    let value = (p * r).mul_add(r, r) + 1.0;
    let exponent = (shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127)) << 23;
    if x < -87.0 { 0.0 } else { value * f32::from_bits(exponent) }
}

/// Error function, absolute error below 5e-7 (Abramowitz and Stegun 7.1.26).
#[inline(always)]
fn erf(x: f32) -> f32 {
    let z = x.abs();
    let t = 1.0 / 0.327_591_1f32.mul_add(z, 1.0);
    let p = 1.061_405_4f32.mul_add(t, -1.453_152);
    let p = p.mul_add(t, 1.421_413_7);
    let p = p.mul_add(t, -0.284_496_72);
    let p = p.mul_add(t, 0.254_829_6);
    (1.0 - p * t * exp_of_negative(-z * z)).copysign(x)
}

/// `x / 2 (1 + erf(x / sqrt 2))`.
#[inline(always)]
pub fn gelu(x: f32) -> f32 {
    0.5 * x * (1.0 + erf(x * std::f32::consts::FRAC_1_SQRT_2))
}

/// Sum of `f(value)` in 16 independent lanes.
#[inline(always)]
pub fn sum(values: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let (runs, rest) = values.as_chunks::<16>();
    let mut lanes = [0.0f32; 16];
    for run in runs {
        lanes.iter_mut().zip(run).for_each(|(l, &v)| *l += f(v));
    }
    total(lanes) + rest.iter().map(|&v| f(v)).sum::<f32>()
}

/// Sum of the lanes by halves, which stay vectors.
#[inline(always)]
fn total(mut lanes: [f32; 16]) -> f32 {
    for half in [8, 4, 2, 1] {
        for l in 0..half {
            lanes[l] += lanes[l + half];
        }
    }
    lanes[0]
}

/// Dot product in 16 independent lanes.
#[inline(always)]
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (runs_a, rest_a) = a.as_chunks::<16>();
    let (runs_b, rest_b) = b.as_chunks::<16>();
    let mut lanes = [0.0f32; 16];
    for (x, y) in runs_a.iter().zip(runs_b) {
        for l in 0..16 {
            lanes[l] += x[l] * y[l];
        }
    }
    total(lanes) + rest_a.iter().zip(rest_b).map(|(x, y)| x * y).sum::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_accurate() {
        for i in 0..100_000 {
            let x = -i as f32 * 8.6e-4;
            let (got, expected) = (exp_of_negative(x) as f64, (x as f64).exp());
            assert!((got - expected).abs() <= 2e-7 * expected, "exp({x}) = {got}, expected {expected}");
        }
        assert_eq!((exp_of_negative(0.0), exp_of_negative(-88.0)), (1.0, 0.0));
    }

    #[test]
    fn erf_is_accurate_and_vectorised_code_computes_the_same() {
        // erf by its series, sum (-1)^n x^(2n+1) / (n! (2n+1)), times 2 / sqrt(pi).
        let series = |x: f64| {
            let (mut term, mut sum) = (x, x);
            for n in 1..80 {
                term *= -x * x / n as f64;
                sum += term / (2 * n + 1) as f64;
            }
            sum * std::f64::consts::FRAC_2_SQRT_PI
        };
        let values: Vec<f32> = (-3000..=3000).map(|i| i as f32 * 1e-3).collect();
        for &x in &values {
            assert!((erf(x) as f64 - series(x as f64)).abs() < 5e-7, "erf({x})");
        }
        let mut vector = values.clone();
        vectorised!(vector.iter_mut().for_each(|x| *x = gelu(*x)));
        for (x, got) in values.iter().zip(&vector) {
            assert!((got - gelu(*x)).abs() <= 1e-7 * x.abs(), "gelu({x})");
        }
        assert_eq!((erf(10.0), erf(-10.0), gelu(0.0)), (1.0, -1.0, 0.0));
    }
}
