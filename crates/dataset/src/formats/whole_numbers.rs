//! Whole numbers of JSON files, also where a program wrote them as floats (`3.0`).

use serde::{Deserialize, Deserializer, de::Error};
use serde_json::Number;

/// An id or a count of things: no negative number, no fraction.
pub(super) fn whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let number = Number::deserialize(deserializer)?;
    exact(&number).and_then(|value| u32::try_from(value).ok()).ok_or_else(|| unexpected(&number))
}

/// An id that the file may lack.
pub(super) fn some_whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u32>, D::Error> {
    whole(deserializer).map(Some)
}

/// A count of pixels, which may be the mean of several.
pub(super) fn rounded<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let number = Number::deserialize(deserializer)?;
    nearest(&number).and_then(|value| u32::try_from(value).ok()).ok_or_else(|| unexpected(&number))
}

/// x, y, width, height in pixels, rounded.
pub(super) fn rounded_box<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[i32; 4], D::Error> {
    let mut values = [0; 4];
    for (value, number) in values.iter_mut().zip(<[Number; 4]>::deserialize(deserializer)?) {
        *value = nearest(&number).and_then(|value| i32::try_from(value).ok()).ok_or_else(|| {
            D::Error::custom(format!("{number} is out of range for a coordinate in pixels"))
        })?;
    }
    Ok(values)
}

fn exact(number: &Number) -> Option<i64> {
    nearest(number).filter(|&value| number.as_i64() == Some(value) || number.as_f64() == Some(value as f64))
}

fn nearest(number: &Number) -> Option<i64> {
    // Beyond 2^53 a float is no certain whole number.
    let of_float = |value: f64| (value.abs() < 9e15).then(|| value.round() as i64);
    number.as_i64().or_else(|| number.as_f64().and_then(of_float))
}

fn unexpected<E: Error>(number: &Number) -> E {
    E::custom(format!("{number}, expected a whole number from 0 to {}", u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Record {
        #[serde(deserialize_with = "whole")]
        id: u32,
        #[serde(deserialize_with = "rounded")]
        pixels: u32,
        #[serde(deserialize_with = "rounded_box")]
        bounds: [i32; 4],
    }

    #[test]
    fn floats_that_are_whole_are_read_and_others_are_named() {
        let read = |id: &str, pixels: &str, bounds: &str| {
            serde_json::from_str::<Record>(&format!(
                r#"{{"id": {id}, "pixels": {pixels}, "bounds": [{bounds}]}}"#
            ))
            .map(|r| (r.id, r.pixels, r.bounds))
            .map_err(|e| e.to_string())
        };
        assert_eq!(read("3.0", "7.6", "1.5, -2.4, 3e1, 4"), Ok((3, 8, [2, -2, 30, 4])));
        assert_eq!(read("4294967295", "0", "0, 0, 0, 0"), Ok((u32::MAX, 0, [0; 4])));
        for (id, pixels, bounds, part) in [
            ("-1", "0", "0, 0, 0, 0", "-1, expected a whole number from 0"),
            ("3.5", "0", "0, 0, 0, 0", "3.5, expected"),
            ("4294967296", "0", "0, 0, 0, 0", "4294967296, expected"),
            ("1e300", "0", "0, 0, 0, 0", "expected a whole number"),
            ("1", "-3", "0, 0, 0, 0", "-3, expected"),
            ("1", "0", "1e12, 0, 0, 0", "out of range"),
            ("null", "0", "0, 0, 0, 0", "null"),
            ("\"1\"", "0", "0, 0, 0, 0", "string"),
        ] {
            let message = read(id, pixels, bounds).unwrap_err();
            assert!(message.contains(part), "{message}");
        }
    }
}
