//! JSON objects and files by the number of an image or object.

use std::{
    collections::{BTreeMap, btree_map},
    fmt,
    marker::PhantomData,
    path::{Path, PathBuf},
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

/// Digits of a number in the name of a file, as BOP has them.
pub(super) const DIGITS: usize = 6;

/// The file in `folder` whose name, made of numbers with that many digits, exists: with BOP's six, else with fewer, as older
/// releases and people's own folders have them (`0012.png`). The one with six digits where there is none.
pub(super) fn numbered_file(folder: &Path, name: impl Fn(usize) -> String) -> PathBuf {
    let path = |digits: usize| folder.join(name(digits));
    let found = (1..=DIGITS).rev().map(path).find(|path| path.is_file());
    found.unwrap_or_else(|| path(DIGITS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_may_have_fewer_digits_in_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let find = |id: u32| {
            let path = numbered_file(folder.path(), |digits| format!("{id:0digits$}_{:0digits$}.png", 1));
            path.file_name().unwrap().to_str().unwrap().to_owned()
        };
        for name in ["0012_0001.png", "12_1.png", "123_1.png", "000004_000001.png", "0004_0001.png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(
            [12, 123, 4, 5].map(find),
            ["0012_0001.png", "123_1.png", "000004_000001.png", "000005_000001.png"]
        );
    }

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
