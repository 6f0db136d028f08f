//! Files of one camera.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::{
    super::FormatError,
    fields::{FORMS, Fields},
    record::{Camera, CameraRecord},
};

/// How OpenCV's YAML files begin; it is no directive of YAML.
const OPENCV_HEADER: &str = "%YAML:";

/// Reads a file of one camera in any of the forms of [the module](super).
pub fn read_camera(path: &Path) -> Result<Camera, FormatError> {
    read_camera_scaled(path, None)
}

/// [`read_camera`] with the depth scale of files that have none, millimetres per unit. An error where the file has another
/// one.
pub fn read_camera_scaled(path: &Path, depth_scale: Option<f64>) -> Result<Camera, FormatError> {
    let place = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|e| FormatError::io(path, e))?;
    let object = object(&bytes, path)?;
    let mut record = match scene(&object, &place) {
        Some(record) => record?,
        None => Fields::new(&object, &place).record()?,
    };
    match (record.depth_scale, depth_scale) {
        (Some(own), Some(given)) if own != given => {
            let expected = format!("{given} as given for files without one");
            return Err(FormatError::field(place, "depth_scale", own, expected));
        }
        (None, None) => {
            if let Some(key) = misspelt_scale(&object) {
                let hint = format!(
                    "{key} is unknown; its value in millimetres per unit of the depth image is expected there"
                );
                return Err(FormatError::missing(place, "depth_scale", hint));
            }
        }
        (own, given) => record.depth_scale = own.or(given),
    }
    record.check_with_lens(&place)
}

/// The file's content as one object: a JSON or YAML file, or the numbers of a matrix.
fn object(bytes: &[u8], path: &Path) -> Result<Map<String, Value>, FormatError> {
    let wrong = |field: &str, value: String, expected: &str| {
        FormatError::field(path.display(), field, value, expected)
    };
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let at = format!("no UTF-8 from byte {} on", error.valid_up_to());
        wrong("text", at, "a camera file in UTF-8")
    })?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.trim_start().starts_with('{') {
        let json = |source| FormatError::Json { path: path.to_path_buf(), source };
        return serde_json::from_str(text).map_err(json);
    }
    if let Some(numbers) = matrix(text) {
        if numbers.len() != 9 {
            return Err(wrong("matrix", format!("{} numbers", numbers.len()), "9, those of a 3 x 3 matrix"));
        }
        return Ok(Map::from_iter([("cam_K".to_owned(), json!(numbers))]));
    }
    let text = match text.strip_prefix(OPENCV_HEADER) {
        Some(rest) => rest.split_once('\n').map_or("", |(_, rest)| rest),
        None => text,
    };
    // What `rostopic echo` writes ends with the beginning of another document.
    let documents: Vec<Value> = serde_saphyr::from_multiple(text).map_err(|error| {
        let text = error.to_string();
        let line = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
        wrong("camera file", format!("no JSON, YAML or matrix ({line})"), FORMS)
    })?;
    match documents.into_iter().next() {
        Some(Value::Object(object)) => Ok(object),
        // A matrix with numbers as strings.
        Some(list @ Value::Array(_)) => Ok(Map::from_iter([("cam_K".to_owned(), list)])),
        _ => Err(FormatError::missing(path.display(), "camera", format!("expected {FORMS}"))),
    }
}

/// The numbers of a text without anything else but brackets, separators and comments.
fn matrix(text: &str) -> Option<Vec<f64>> {
    let lines = text.lines().map(|line| line.split(['#', '%']).next().unwrap_or_default());
    let words = lines.flat_map(|line| line.split(|c: char| c.is_whitespace() || ",;[]".contains(c)));
    let numbers: Option<Vec<f64>> =
        words.filter(|word| !word.is_empty()).map(|word| word.parse().ok()).collect();
    numbers.filter(|numbers| !numbers.is_empty())
}

/// The camera of a `scene_camera.json`, which is to be the same in all images; `None` for other files.
fn scene(object: &Map<String, Value>, place: &str) -> Option<Result<CameraRecord, FormatError>> {
    let images: Vec<(&String, &Map<String, Value>)> = object
        .iter()
        .map(|(key, value)| Some((key, value.as_object().filter(|_| key.parse::<u32>().is_ok())?)))
        .collect::<Option<_>>()?;
    let record = |(key, image): &(&String, &Map<String, Value>)| -> Result<CameraRecord, FormatError> {
        let place = format!("{place}: image {key}");
        let record = Fields::new(image, &place).record()?;
        // Poses of the camera differ and are of no use here.
        Ok(CameraRecord { cam_r_w2c: None, cam_t_w2c: None, ..record })
    };
    let (first, others) = images.split_first()?;
    let same = || {
        let camera = record(first)?;
        for other in others {
            if record(other)? != camera {
                let value = format!("another in image {} than in image {}", other.0, first.0);
                return Err(FormatError::field(place, "camera", value, "one camera: a file with one entry"));
            }
        }
        Ok(camera)
    };
    Some(same())
}

/// A key that may be meant as `depth_scale`.
fn misspelt_scale(object: &Map<String, Value>) -> Option<String> {
    let letters =
        |key: &String| key.chars().filter(char::is_ascii_alphabetic).collect::<String>().to_lowercase();
    let meant = |key: &&String| {
        let letters = letters(key);
        let about = ["scale", "scal", "unit", "factor", "sclae"].iter().any(|word| letters.contains(word));
        *key != "depth_scale" && (letters.contains("depth") && about || letters == "scale")
    };
    object.keys().find(meant).cloned()
}
