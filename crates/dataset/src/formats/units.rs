//! What gives away that metres stand where BOP has millimetres: sizes and distances no camera would have seen.

use std::ops::RangeInclusive;

/// Objects that a camera on a desk or a robot looks at, metres.
const DIAMETER: RangeInclusive<f64> = 0.005..=5.0;
/// Distances of annotated objects, metres; what lies outside was written in another unit.
const DISTANCE: RangeInclusive<f64> = 0.02..=20.0;
/// Medians of distances (or depths) of the same objects agree to this factor, however bad the poses are.
const SAME: f64 = 5.0;

const MM: f64 = 1000.0;

/// What is wrong with an object's diameter (metres), in words.
pub fn diameter_problem(diameter: f64) -> Option<String> {
    (!DIAMETER.contains(&diameter))
        .then(|| format!("diameter is {:.3} mm; models are expected in millimetres", diameter * MM))
}

/// What is wrong with an annotated object's distance from the camera (metres), in words.
pub fn distance_problem(distance: f64) -> Option<String> {
    (!DISTANCE.contains(&distance)).then(|| {
        format!("lies {:.1} mm from the camera; cam_t_m2c is expected in millimetres", distance * MM)
    })
}

/// What is wrong with the distances of annotated objects and of the poses of a result table (metres), by their medians.
pub fn table_problems(table: &mut [f64], annotated: &mut [f64]) -> Vec<String> {
    let (found, Some(truth)) = (median(table), median(annotated)) else { return Vec::new() };
    if DISTANCE.contains(&truth) {
        let differs = |found: &f64| !(1.0 / SAME..=SAME).contains(&(found / truth));
        let problem = |found: f64| {
            format!(
                "median distance of the table's poses is {}, of the annotations {} (mm): {}",
                digits(found),
                digits(truth),
                unit_question("the table's translations", found / truth)
            )
        };
        return found.filter(differs).map(problem).into_iter().collect();
    }
    // Only the known range of distances is left to compare with.
    let all =
        [("annotations", "cam_t_m2c", Some(truth)), ("table's poses", "the table's translations", found)];
    let implausible = all.into_iter().filter_map(|(of, what, median)| {
        let median = median.filter(|median| !DISTANCE.contains(median))?;
        let factor = if DISTANCE.contains(&(median * MM)) { 1.0 / MM } else { f64::NAN };
        let question = unit_question(what, factor);
        Some(format!("median distance of the {of} is {} (mm): {question}", digits(median)))
    });
    implausible.collect()
}

/// What is wrong with the measured depth of objects against that of their posed models (metres), by their medians.
pub fn depth_problem(measured: &mut [f64], posed: &mut [f64]) -> Option<String> {
    let (measured, posed) = (median(measured)?, median(posed)?);
    (DISTANCE.contains(&posed) && !(1.0 / SAME..=SAME).contains(&(measured / posed))).then(|| {
        format!(
            "median measured depth on the annotated objects is {} mm, of their posed models {} mm: is depth_scale right?",
            digits(measured),
            digits(posed)
        )
    })
}

/// Two numbers (metres) for the diameter of the same model that no rounding explains, in words.
pub fn diameters_disagree(own: f64, said: f64) -> Option<String> {
    (!(1.0 / SAME..=SAME).contains(&(own / said)))
        .then(|| format!("diameter is {} mm, models_info.json says {} mm", digits(own), digits(said)))
}

/// Asks for the unit that a factor against millimetres gives away.
fn unit_question(what: &str, factor: f64) -> String {
    match factor.log10().round() {
        -3.0 => format!("are {what} in metres?"),
        -1.0 => format!("are {what} in centimetres?"),
        3.0 => format!("are {what} in micrometres?"),
        _ => format!("{what} should be in millimetres"),
    }
}

/// Of metres: about three digits of the number in millimetres.
fn digits(metres: f64) -> String {
    let decimals = match (metres * MM).abs() {
        mm if mm >= 100.0 => 0,
        mm if mm >= 1.0 => 1,
        _ => 3,
    };
    format!("{:.decimals$}", metres * MM)
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_give_metres_away() {
        let problems =
            |table: &[f64], truth: &[f64]| table_problems(&mut table.to_vec(), &mut truth.to_vec());
        let truth = [0.9, 0.7, 0.812, 5.0, 0.1];
        assert_eq!(
            problems(&[0.0009, 0.00081, 0.0001], &truth),
            [
                "median distance of the table's poses is 0.810, of the annotations 812 (mm): are the table's translations in metres?"
            ]
        );
        assert!(
            problems(&[0.08, 0.09], &truth)[0]
                .contains("90.0, of the annotations 812 (mm): are the table's translations in centimetres?")
        );
        assert!(problems(&[30.0], &truth)[0].ends_with("the table's translations should be in millimetres"));
        // Bad poses of the right unit, and none.
        assert_eq!(problems(&[0.4, 1.6, 0.3], &truth), Vec::<String>::new());
        assert_eq!(problems(&[], &truth), Vec::<String>::new());
        assert_eq!(problems(&[0.8], &[]), Vec::<String>::new());
        // Annotations in metres: the table is only wrong when it is implausible itself.
        assert_eq!(
            problems(&[0.7], &[0.0007]),
            ["median distance of the annotations is 0.700 (mm): are cam_t_m2c in metres?"]
        );
        assert_eq!(problems(&[0.0008], &[0.0007]).len(), 2);
    }

    #[test]
    fn sizes_and_depths_out_of_range_are_told() {
        assert!(diameter_problem(0.000137).unwrap().contains("0.137 mm; models are expected in millimetres"));
        assert_eq!(diameter_problem(0.137), None);
        assert!(distance_problem(0.0007).unwrap().contains("lies 0.7 mm from the camera"));
        assert_eq!(distance_problem(0.7), None);
        let found = diameters_disagree(0.137, 0.000137).unwrap();
        assert_eq!(found, "diameter is 137 mm, models_info.json says 0.137 mm");
        assert_eq!(diameters_disagree(0.137, 0.14), None);
        let depth = depth_problem(&mut [7.2, 7.1, 7.3], &mut [0.72, 0.7, 0.74]).unwrap();
        assert!(depth.contains("is 7200 mm, of their posed models 720 mm"), "{depth}");
        assert_eq!(depth_problem(&mut [0.7], &mut [0.72]), None);
    }
}
