//! The names under which cameras' tools write the same things.

use serde_json::{Map, Value};

use super::{super::FormatError, lens, record::CameraRecord};

const MATRIX: [&str; 8] =
    ["cam_K", "K", "k", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "intrinsics", "intrinsic"];
/// Column by column when flat, as Open3D writes it.
const OPEN3D_MATRIX: &str = "intrinsic_matrix";
const FOCAL_AND_PRINCIPAL: [&[&str]; 4] = [&["fx"], &["fy"], &["cx", "ppx"], &["cy", "ppy"]];
/// Objects inside the file's object that may hold a part of the camera.
const INNER: [&str; 5] = ["intrinsics", "intrinsic", "camera_intrinsics", "color_intrinsics", "distortion"];
/// Open3D counts the units of a metre where BOP has the millimetres of a unit; there is no doubt from here on.
const OPEN3D_SCALE: f64 = 100.0;
/// More numbers than any field has.
const MAX_NUMBERS: usize = 64;

/// Which forms a camera may have, for messages.
pub(super) const FORMS: &str = "cam_K or K (9 numbers), fx, fy, cx, cy (or ppx, ppy), intrinsic_matrix of Open3D, \
                                camera_matrix of ROS or OpenCV, or a text of 3 x 3 numbers";

/// The fields of a camera.
pub(super) struct Fields<'a> {
    /// The file's object last, objects inside it before.
    levels: Vec<&'a Map<String, Value>>,
    /// File and entry, for messages.
    place: &'a str,
}

impl<'a> Fields<'a> {
    pub fn new(object: &'a Map<String, Value>, place: &'a str) -> Self {
        let inner = INNER.iter().filter_map(|name| object.get(*name)?.as_object());
        Self { levels: inner.chain([object]).collect(), place }
    }

    /// The camera; only its form is checked.
    pub fn record(&self) -> Result<CameraRecord, FormatError> {
        let cam_k = match (self.matrix()?, self.focal_and_principal()?) {
            (Some((name, matrix)), Some(other)) if matrix != other => {
                let expected = format!("fx, fy, cx, cy as in {name}: {matrix:?}");
                return Err(self.wrong("the other camera of the file", &format!("{other:?}"), &expected));
            }
            (Some((_, matrix)), _) | (None, Some(matrix)) => matrix,
            (None, None) => {
                return Err(FormatError::missing(self.place, "camera", format!("expected {FORMS}")));
            }
        };
        let depth_scale = self.number(&["depth_scale"])?;
        if let Some(scale) = depth_scale.filter(|scale| *scale >= OPEN3D_SCALE)
            && self.find(&[OPEN3D_MATRIX]).is_some()
        {
            let expected = format!(
                "millimetres per unit; beside Open3D's {OPEN3D_MATRIX} it looks like units per metre, which are {} \
                 millimetres per unit",
                1000.0 / scale
            );
            return Err(self.wrong("depth_scale", &scale.to_string(), &expected));
        }
        Ok(CameraRecord {
            cam_k,
            depth_scale,
            width: self.pixels(&["width", "image_width"])?,
            height: self.pixels(&["height", "image_height"])?,
            cam_r_w2c: self.array("cam_R_w2c")?,
            cam_t_w2c: self.array("cam_t_w2c")?,
            distortion: lens::distortion(self)?,
        })
    }

    /// The name and the value of the first of these fields that is there.
    pub fn find(&self, names: &[&'static str]) -> Option<(&'static str, &'a Value)> {
        let named = |name: &&'static str| {
            let mut levels = self.levels.iter().filter_map(|level| level.get(*name));
            // An object without numbers of its own is a level.
            let value =
                levels.find(|value| !value.is_null() && (!value.is_object() || value.get("data").is_some()));
            Some((*name, value?))
        };
        names.iter().find_map(named)
    }

    /// A number, which may be a string.
    pub fn number(&self, names: &[&'static str]) -> Result<Option<f64>, FormatError> {
        match self.find(names) {
            None => Ok(None),
            Some((name, value)) => match number(value) {
                Some(number) => Ok(Some(number)),
                None => Err(self.wrong(name, &short(value), "a number")),
            },
        }
    }

    /// The numbers of a list, of lists in a list or of an object's `data`.
    pub fn numbers(&self, name: &str, value: &Value) -> Result<Vec<f64>, FormatError> {
        let mut numbers = Vec::new();
        if collect(value.get("data").unwrap_or(value), &mut numbers) {
            return Ok(numbers);
        }
        Err(self.wrong(name, &short(value), "a list of numbers"))
    }

    pub fn wrong(&self, name: &str, value: &str, expected: &str) -> FormatError {
        FormatError::field(self.place, name, value, expected)
    }

    fn matrix(&self) -> Result<Option<(&'static str, [f64; 9])>, FormatError> {
        let Some((name, value)) = self.find(&MATRIX) else { return Ok(None) };
        let numbers = self.numbers(name, value)?;
        let Ok(matrix) = <[f64; 9]>::try_from(numbers.as_slice()) else {
            let met = format!("a list of {} numbers", numbers.len());
            return Err(self.wrong(name, &met, "9 numbers, those of a 3 x 3 matrix"));
        };
        let flat = value.as_array().is_some_and(|list| list.len() == 9);
        // A matrix whose last row is 0 0 1 was written row by row all the same.
        if name == OPEN3D_MATRIX && flat && matrix[6..8] != [0.0; 2] {
            return Ok(Some((name, std::array::from_fn(|i| matrix[i % 3 * 3 + i / 3]))));
        }
        Ok(Some((name, matrix)))
    }

    /// As a matrix; `None` where none of the four is there.
    fn focal_and_principal(&self) -> Result<Option<[f64; 9]>, FormatError> {
        let mut values = [None; 4];
        for (value, names) in values.iter_mut().zip(FOCAL_AND_PRINCIPAL) {
            *value = self.number(names)?;
        }
        match values {
            [Some(fx), Some(fy), Some(cx), Some(cy)] => Ok(Some([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])),
            // Single ones mean something else where there is a matrix.
            _ if values == [None; 4] || self.find(&MATRIX).is_some() => Ok(None),
            _ => {
                let absent = values.iter().zip(FOCAL_AND_PRINCIPAL).filter(|(value, _)| value.is_none());
                let names: Vec<&str> = absent.map(|(_, names)| names[0]).collect();
                Err(FormatError::missing(self.place, names.join(", "), format!("expected {FORMS}")))
            }
        }
    }

    fn pixels(&self, names: &[&'static str]) -> Result<Option<u32>, FormatError> {
        match self.number(names)? {
            // ROS cameras that were not set up have 0.
            None | Some(0.0) => Ok(None),
            Some(value) if value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 => {
                Ok(Some(value as u32))
            }
            Some(value) => Err(self.wrong(names[0], &format!("{value:?}"), "a number of pixels")),
        }
    }

    fn array<const N: usize>(&self, name: &'static str) -> Result<Option<[f64; N]>, FormatError> {
        let Some((_, value)) = self.find(&[name]) else { return Ok(None) };
        let numbers = self.numbers(name, value)?;
        match numbers.as_slice().try_into() {
            Ok(array) => Ok(Some(array)),
            Err(_) => Err(self.wrong(name, &short(value), &format!("{N} numbers"))),
        }
    }
}

/// A number or a string that is one.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::String(text) => text.trim().parse().ok(),
        _ => value.as_f64(),
    }
}

/// Are there numbers alone, and not too many?
fn collect(value: &Value, numbers: &mut Vec<f64>) -> bool {
    match value {
        Value::Array(list) => list.iter().all(|item| collect(item, numbers)),
        _ => match number(value) {
            Some(number) if numbers.len() < MAX_NUMBERS => {
                numbers.push(number);
                true
            }
            _ => false,
        },
    }
}

/// The beginning of a value as JSON.
pub(super) fn short(value: &Value) -> String {
    let mut text = value.to_string();
    if let Some((end, _)) = text.char_indices().nth(80) {
        text.truncate(end);
        text.push_str("...");
    }
    text
}
