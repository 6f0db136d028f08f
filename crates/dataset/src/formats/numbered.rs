//! JSON objects by the number of an image or object.

use std::{
    collections::{BTreeMap, btree_map},
    fmt,
    marker::PhantomData,
};

use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, Visitor},
};

/// A JSON object whose keys are ids, each there once.
pub(super) struct ById<T>(pub BTreeMap<u32, T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for ById<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ByIdVisitor(PhantomData)).map(Self)
    }
}

struct ByIdVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for ByIdVisitor<T> {
    type Value = BTreeMap<u32, T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object whose keys are ids")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut entries = BTreeMap::new();
        while let Some(key) = map.next_key::<String>()? {
            let id = id_of(&key)
                .ok_or_else(|| A::Error::custom(format!("key {key:?}, expected an id, as in \"12\"")))?;
            match entries.entry(id) {
                btree_map::Entry::Vacant(vacant) => vacant.insert(map.next_value()?),
                btree_map::Entry::Occupied(_) => {
                    return Err(A::Error::custom(format!("{id} is there twice, expected once")));
                }
            };
        }
        Ok(entries)
    }
}

/// Digits alone; leading zeros do not matter.
pub(super) fn id_of(text: &str) -> Option<u32> {
    let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    text.parse().ok().filter(|_| digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_ids_and_each_is_there_once() {
        let read = |text: &str| {
            serde_json::from_str::<ById<u8>>(text).map(|by_id| by_id.0).map_err(|e| e.to_string())
        };
        assert_eq!(read(r#"{"000012": 3, "1": 4}"#), Ok([(12, 3), (1, 4)].into()));
        for (text, part) in [
            (r#"{"1": 1, "01": 2}"#, "1 is there twice"),
            (r#"{"1": 1, "1": 2}"#, "1 is there twice"),
            (r#"{"-1": 1}"#, "\"-1\", expected an id"),
            (r#"{"+1": 1}"#, "\"+1\", expected an id"),
            (r#"{"4294967296": 1}"#, "\"4294967296\", expected an id"),
            (r#"{"": 1}"#, "expected an id"),
            ("[1]", "expected an object whose keys are ids"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(part), "{message}");
        }
    }
}
