//! The safetensors file: named f32 arrays and string metadata.

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    path::Path,
};

use burn::tensor::{DType, TensorData};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::CheckpointError;
use crate::formats::write_atomic;

/// Contents of a checkpoint file on the host.
pub struct TensorFile {
    pub tensors: BTreeMap<String, TensorData>,
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Reads all tensors as f32; half precision is widened.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes =
            std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes, path)
    }

    /// [`Self::read`] without the tensors that `skip` names, whose names are returned; they may be of any type.
    pub fn read_without(
        path: &Path,
        skip: impl Fn(&str) -> bool,
    ) -> Result<(Self, Vec<String>), CheckpointError> {
        let bytes =
            std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::parse(&bytes, path, skip)
    }

    /// [`Self::read`] of a file that is already in memory; `path` is only for messages.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, CheckpointError> {
        Ok(Self::parse(bytes, path, |_| false)?.0)
    }

    fn parse(
        bytes: &[u8],
        path: &Path,
        skip: impl Fn(&str) -> bool,
    ) -> Result<(Self, Vec<String>), CheckpointError> {
        let format = |e: safetensors::SafeTensorError| CheckpointError::Format {
            path: path.to_owned(),
            message: e.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(format)?;
        let metadata = header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
        let file = SafeTensors::deserialize(bytes).map_err(format)?;
        let (mut tensors, mut skipped) = (BTreeMap::new(), Vec::new());
        for (name, view) in file.iter() {
            if skip(name) {
                skipped.push(name.to_owned());
            } else {
                tensors.insert(name.to_owned(), read_tensor(path, name, &view)?);
            }
        }
        Ok((Self { tensors, metadata }, skipped))
    }

    /// Writes the file in one rename: readers see the old file or the new one, never a part.
    pub fn write(&self, path: &Path) -> Result<(), CheckpointError> {
        let views: Vec<(&String, TensorView<'_>)> = self
            .tensors
            .iter()
            .map(|(name, data)| {
                let view = TensorView::new(Dtype::F32, data.shape().to_vec(), data.as_bytes());
                view.map(|view| (name, view)).map_err(|e| CheckpointError::Tensor {
                    path: path.to_owned(),
                    name: name.clone(),
                    message: e.to_string(),
                })
            })
            .collect::<Result<_, _>>()?;
        let metadata: HashMap<String, String> = self.metadata.clone().into_iter().collect();
        let bytes = safetensors::serialize(views, Some(metadata))
            .map_err(|e| CheckpointError::Format { path: path.to_owned(), message: e.to_string() })?;
        Ok(write_atomic(path, |writer| writer.write_all(&bytes))?)
    }
}

fn read_tensor(path: &Path, name: &str, view: &TensorView<'_>) -> Result<TensorData, CheckpointError> {
    let error =
        |message: String| CheckpointError::Tensor { path: path.to_owned(), name: name.to_owned(), message };
    let dtype = match view.dtype() {
        Dtype::F32 => DType::F32,
        Dtype::F16 => DType::F16,
        Dtype::BF16 => DType::BF16,
        other => return Err(error(format!("type is {other:?}, expected F32, F16 or BF16"))),
    };
    let data =
        TensorData::from_bytes_vec(view.data().to_vec(), view.shape().to_vec(), dtype).convert::<f32>();
    match data.as_slice::<f32>() {
        Ok(values) if values.iter().all(|v| v.is_finite()) => Ok(data),
        Ok(_) => Err(error("contains NaN or infinity".into())),
        Err(e) => Err(error(format!("{e:?}"))),
    }
}
