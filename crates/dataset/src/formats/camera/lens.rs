//! Lens distortion in camera files: which model, which coefficients.

use unopose_core::geometry::Distortion;

use super::{
    super::FormatError,
    fields::{Fields, short},
};

const COEFFICIENTS: [&str; 8] = [
    "D",
    "d",
    "coeffs",
    "dist_coeffs",
    "distCoeffs",
    "distortion_coefficients",
    "distortion_coeffs",
    "distortion",
];
/// In OpenCV's order.
const SINGLE: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
const MODEL: [&str; 3] = ["distortion_model", "dist_model", "model"];
/// Names of Brown and Conrady's model with coefficients in OpenCV's order, letters and digits alone.
const BROWN_CONRADY: [&str; 9] = [
    "",
    "none",
    "pinhole",
    "plumbbob",
    "brownconrady",
    "radtan",
    "radialtangential",
    "rationalpolynomial",
    "opencv",
];
/// Parts of the names of models that bend lines even where all coefficients are 0.
const FISHEYES: [&str; 6] = ["fisheye", "equidistant", "kannala", "ftheta", "omni", "sphere"];
const EXPECTED: &str =
    "plumb_bob, Brown-Conrady or rational_polynomial, or images that are undistorted before";

/// The lens's distortion; `None` where it has none. An error where it has one that is not undone.
pub(super) fn distortion(fields: &Fields<'_>) -> Result<Option<Distortion>, FormatError> {
    let (model_field, model) = model(fields)?;
    if FISHEYES.iter().any(|part| model.contains(part)) {
        return Err(fields.wrong(model_field, &format!("{model:?}"), EXPECTED));
    }
    let (name, coefficients) = coefficients(fields)?;
    if coefficients.iter().all(|c| *c == 0.0) {
        return Ok(None);
    }
    if let Some(wrong) = coefficients.iter().find(|c| !c.is_finite()) {
        return Err(fields.wrong(name, &wrong.to_string(), "finite numbers"));
    }
    if !BROWN_CONRADY.contains(&model.as_str()) {
        let met = format!("{model:?} with coefficients {coefficients:?}");
        return Err(fields.wrong(model_field, &met, EXPECTED));
    }
    let (used, rest) = coefficients.split_at(coefficients.len().min(8));
    if rest.iter().any(|c| *c != 0.0) {
        let expected = "0 from the ninth on: thin prisms and tilted sensors are not undone";
        return Err(fields.wrong(name, &format!("{coefficients:?}"), expected));
    }
    let [k1, k2, p1, p2, k3, k4, k5, k6] = match used.len() {
        4 | 5 | 8 => std::array::from_fn(|i| used.get(i).copied().unwrap_or(0.0)),
        count => {
            let met = format!("a list of {count} numbers");
            return Err(fields.wrong(name, &met, "k1, k2, p1, p2, then none, k3, or k3, k4, k5, k6"));
        }
    };
    Ok(Some(Distortion { radial: [k1, k2, k3, k4, k5, k6], tangential: [p1, p2] }))
}

/// The field's name and the model's, letters and digits alone.
fn model(fields: &Fields<'_>) -> Result<(&'static str, String), FormatError> {
    let text_in = |name| fields.find(&[name]).filter(|(_, value)| value.is_string());
    let found = fields.find(&MODEL).or_else(|| text_in("distortion"));
    let Some((name, value)) = found else { return Ok((MODEL[0], String::new())) };
    if let Some(number) = value.as_u64() {
        // `rs2_distortion` of RealSense.
        let names = [
            "none",
            "modifiedbrownconrady",
            "inversebrownconrady",
            "ftheta",
            "brownconrady",
            "kannalabrandt",
        ];
        let model = usize::try_from(number).ok().and_then(|number| names.get(number));
        let known = || fields.wrong(name, &number.to_string(), "0 to 5 or the model's name");
        return Ok((name, (*model.ok_or_else(known)?).to_owned()));
    }
    let Some(text) = value.as_str() else {
        return Err(fields.wrong(name, &short(value), "the model's name"));
    };
    let letters: String = text.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_lowercase();
    let letters = letters.strip_prefix("rs2").unwrap_or(&letters);
    Ok((name, letters.strip_prefix("distortion").unwrap_or(letters).to_owned()))
}

/// The field's name and the coefficients in OpenCV's order, none where the file has none.
fn coefficients(fields: &Fields<'_>) -> Result<(&'static str, Vec<f64>), FormatError> {
    if let Some((name, value)) = fields.find(&COEFFICIENTS).filter(|(_, value)| !value.is_string()) {
        return Ok((name, fields.numbers(name, value)?));
    }
    let single: Vec<f64> = SINGLE
        .iter()
        .map(|name| Ok(fields.number(&[*name])?.unwrap_or(0.0)))
        .collect::<Result<_, FormatError>>()?;
    Ok(("k1", single))
}
