//! The float tensors of one kind of network in a file.

use std::{collections::BTreeMap, path::Path};

use burn::tensor::{DType, TensorData};

use super::{
    CheckpointError,
    file::as_f32,
    stored::{Container, Layout, Stored},
};

/// Tensors as f32 under the names of the file.
#[derive(Clone, Debug)]
pub struct NamedTensors {
    /// Values by their name in the file.
    pub tensors: BTreeMap<String, TensorData>,
    /// Names of stored tensors that the network does not use.
    pub unused: Vec<String>,
    /// Conversions and what was left out, one sentence each.
    pub notices: Vec<String>,
}

impl NamedTensors {
    /// Reads the tensors of this layout; `None` when the file has none. `unused` are parts of names that are only listed.
    pub fn read(path: &Path, layout: &Layout, unused: &[&str]) -> Result<Option<Self>, CheckpointError> {
        let container = Container::open(path)?;
        let Some(place) = container.place(path, layout)? else { return Ok(None) };
        let (stored, notices) = container.read(path, place)?;
        let mut named = Self { tensors: BTreeMap::new(), unused: Vec::new(), notices };
        let mut converted: BTreeMap<String, usize> = BTreeMap::new();
        for Stored { name, shape, dtype, bytes } in stored {
            if unused.iter().any(|part| name.contains(part)) {
                named.unused.push(name);
                continue;
            }
            if dtype != DType::F32 {
                *converted.entry(format!("{dtype:?}")).or_default() += 1;
            }
            let data = as_f32(path, &name, bytes, shape, dtype)?;
            named.tensors.insert(name, data);
        }
        let notices = converted.iter().map(|(dtype, n)| format!("{n} tensors converted from {dtype} to F32"));
        named.notices.extend(notices);
        Ok(Some(named))
    }
}

/// What a file holds, for a message about what it does not hold.
pub fn contents(path: &Path) -> Result<String, CheckpointError> {
    Ok(Container::open(path)?.describe(path))
}
