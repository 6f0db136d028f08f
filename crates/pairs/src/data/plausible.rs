//! Are distance and size of a masked object those of an object in front of a depth camera, or is the unit wrong?

use std::ops::RangeInclusive;

/// Radii of reference objects that are accepted, metres.
pub const RADIUS: RangeInclusive<f64> = 0.002..=2.0;
/// Distances from the camera that are accepted, metres: depth cameras measure from about 0.1 to 10 m.
pub const DISTANCE: RangeInclusive<f64> = 0.05..=20.0;
/// Radii of objects that are handled, metres.
const USUAL_RADIUS: RangeInclusive<f64> = 0.008..=0.5;
/// Distances at which objects are handled and measured well, metres.
const USUAL_DISTANCE: RangeInclusive<f64> = 0.15..=4.0;
/// Largest radius of an object, distances: what is seen at a wider angle is no object, in whatever unit.
const WIDEST: f64 = 0.6;
/// The middle of both ranges, by which units are compared: distance and radius, metres.
const MIDDLE: [f64; 2] = [0.7, 0.08];
/// Depth units in use, millimetres, each with how much less it is to be expected (natural logarithm of a ratio).
const UNITS: [(f64, f64); 6] = [(1.0, 0.0), (0.1, 0.0), (1000.0, 0.0), (0.25, 1.5), (0.2, 1.5), (10.0, 1.5)];

/// How likely a distance and a size are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Plausibility {
    /// As objects on a table.
    Usual,
    /// Possible, but more often a wrong unit of depth.
    Unusual,
    /// Not what a depth camera sees.
    Impossible,
}

/// Of an object's distance from the camera and its radius, metres.
pub fn plausibility(distance: f64, radius: f64) -> Plausibility {
    if !(DISTANCE.contains(&distance) && RADIUS.contains(&radius)) {
        Plausibility::Impossible
    } else if USUAL_DISTANCE.contains(&distance) && USUAL_RADIUS.contains(&radius) {
        Plausibility::Usual
    } else {
        Plausibility::Unusual
    }
}

/// By what `depth_scale` has to be multiplied to make the object a usual one. The result is one of the units in use where the
/// present `depth_scale` is known, a power of ten otherwise; `None` when no unit helps, or none is needed.
pub fn scale_correction(distance: f64, radius: f64, depth_scale: Option<f64>) -> Option<f64> {
    if plausibility(distance, radius) == Plausibility::Usual || radius > WIDEST * distance {
        return None;
    }
    let units: Vec<(f64, f64)> = match depth_scale {
        Some(present) => UNITS.iter().map(|(unit, less)| (unit / present, *less)).collect(),
        None => [1e-4, 1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 1e4].iter().map(|&factor| (factor, 0.0)).collect(),
    };
    let usual = |factor: f64| plausibility(distance * factor, radius * factor) == Plausibility::Usual;
    let cost = |(factor, less): &(f64, f64)| {
        (distance * factor / MIDDLE[0]).ln().abs() + (radius * factor / MIDDLE[1]).ln().abs() + less
    };
    let candidates = units.into_iter().filter(|(factor, _)| usual(*factor));
    candidates.min_by(|a, b| cost(a).total_cmp(&cost(b))).map(|(factor, _)| factor)
}

/// What is wrong with the unit, for messages; empty when no unit makes the object usual.
pub(super) fn unit_hint(distance: f64, radius: f64) -> String {
    match scale_correction(distance, radius, None) {
        Some(factor) if factor < 1.0 => {
            format!(": depth_scale (depth unit to millimetres) seems {:.0} times too large", 1.0 / factor)
        }
        Some(factor) => {
            format!(": depth_scale (depth unit to millimetres) seems {factor:.0} times too small")
        }
        None => ": is depth_scale (depth unit to millimetres) right, and is the mask the object's?".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_unit_is_named_with_the_right_one() {
        // The same can, 0.72 m away, read in other units than its own.
        for (right, taken) in
            [(0.1, 1.0), (1.0, 0.1), (1.0, 1000.0), (1000.0, 1.0), (0.1, 1000.0), (10.0, 1.0)]
        {
            let (distance, radius) = (0.72 * taken / right, 0.07 * taken / right);
            let unit = scale_correction(distance, radius, Some(taken)).map(|factor| factor * taken);
            assert!(
                unit.is_some_and(|unit| (unit / right - 1.0).abs() < 1e-12),
                "{right} as {taken}: {unit:?}"
            );
            let factor = scale_correction(distance, radius, None);
            assert!(factor.is_some_and(|factor| (factor * taken / right - 1.0).abs() < 1e-9), "{factor:?}");
        }
        assert_eq!(scale_correction(0.72, 0.07, Some(1.0)), None);
        // Neither unit makes an object of a wall.
        assert_eq!(scale_correction(3.0, 3.0, Some(1.0)), None);
        assert!(unit_hint(720.0, 70.0).contains("1000 times too large"));
        assert!(unit_hint(0.00072, 0.00007).contains("1000 times too small"));
        assert!(unit_hint(3.0, 3.0).contains("mask"));
    }

    #[test]
    fn bands_follow_depth_cameras() {
        use Plausibility::*;
        for (distance, radius, expected) in [
            (0.7, 0.1, Usual),
            (0.3, 0.01, Usual),
            (2.5, 0.4, Usual),
            (7.2, 0.7, Unusual),
            (0.07, 0.006, Unusual),
            (0.04, 0.01, Impossible),
            (25.0, 0.5, Impossible),
            (1.0, 2.1, Impossible),
            (0.2, 0.0015, Impossible),
            (f64::NAN, 0.1, Impossible),
        ] {
            assert_eq!(plausibility(distance, radius), expected, "{distance} {radius}");
        }
    }
}
