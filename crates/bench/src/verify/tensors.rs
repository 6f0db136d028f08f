//! Reference tensors as they lie in a file.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use burn::tensor::{DType, TensorData};
use safetensors::{Dtype, SafeTensors};
use unopose_core::geometry::Pose;

use super::VerifyError;

/// A tensor on the host; `f64` holds every stored type exactly (64-bit integers up to 2^53).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HostTensor {
    pub shape: Vec<usize>,
    /// Row-major.
    pub values: Vec<f64>,
    /// Stored as integers or booleans.
    pub integer: bool,
}

/// All tensors of a file by name.
#[derive(Clone, Debug)]
pub struct ReferenceTensors {
    path: PathBuf,
    pub(super) tensors: BTreeMap<String, HostTensor>,
}

impl ReferenceTensors {
    /// Reads a safetensors file.
    pub fn read(path: &Path) -> Result<Self, VerifyError> {
        let bytes =
            std::fs::read(path).map_err(|source| VerifyError::Read { path: path.to_owned(), source })?;
        let format = |e: safetensors::SafeTensorError| VerifyError::Format {
            path: path.to_owned(),
            message: e.to_string(),
        };
        let file = SafeTensors::deserialize(&bytes).map_err(format)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let (dtype, integer) = match view.dtype() {
                Dtype::F64 => (DType::F64, false),
                Dtype::F32 => (DType::F32, false),
                Dtype::F16 => (DType::F16, false),
                Dtype::BF16 => (DType::BF16, false),
                Dtype::I64 => (DType::I64, true),
                Dtype::I32 => (DType::I32, true),
                Dtype::U8 | Dtype::BOOL => (DType::U8, true),
                other => {
                    return Err(VerifyError::Tensor {
                        path: path.to_owned(),
                        name: name.to_owned(),
                        message: format!("has type {other:?}, expected a float, I64, I32, U8 or BOOL"),
                    });
                }
            };
            let shape = view.shape().to_vec();
            let data = TensorData::from_bytes_vec(view.data().to_vec(), shape.clone(), dtype);
            tensors
                .insert(name.to_owned(), HostTensor { shape, values: data.iter::<f64>().collect(), integer });
        }
        Ok(Self { path: path.to_owned(), tensors })
    }

    pub(super) fn contains(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    pub(super) fn error(&self, name: &str, message: String) -> VerifyError {
        VerifyError::Tensor { path: self.path.clone(), name: name.to_owned(), message }
    }

    /// A tensor of `rank` axes, `batch` items on the first and finite values.
    fn get(&self, name: &str, rank: usize, batch: Option<usize>) -> Result<&HostTensor, VerifyError> {
        let tensor = self
            .tensors
            .get(name)
            .ok_or_else(|| self.error(name, "is missing, expected it as an input".into()))?;
        if tensor.shape.len() != rank
            || tensor.shape.contains(&0)
            || batch.is_some_and(|b| b != tensor.shape[0])
        {
            let batch = batch.map_or("a batch".into(), |b| format!("{b} items"));
            let message = format!("has shape {:?}, expected {rank} axes, the first of {batch}", tensor.shape);
            return Err(self.error(name, message));
        }
        if tensor.values.iter().any(|v| !v.is_finite()) {
            return Err(self.error(name, "contains NaN or infinity".into()));
        }
        Ok(tensor)
    }

    /// Shape of an input of `rank` axes.
    pub(super) fn shape(&self, name: &str, rank: usize) -> Result<&[usize], VerifyError> {
        Ok(&self.get(name, rank, None)?.shape)
    }

    /// Item `b` of a batch of floats.
    pub(super) fn item(
        &self,
        name: &str,
        rank: usize,
        b: usize,
        batch: usize,
    ) -> Result<Vec<f32>, VerifyError> {
        let tensor = self.get(name, rank, Some(batch))?;
        let n = tensor.values.len() / batch;
        Ok(tensor.values[b * n..(b + 1) * n].iter().map(|&v| v as f32).collect())
    }

    /// Item `b` of clouds `[B, N, 3]`.
    pub(super) fn points(&self, name: &str, b: usize, batch: usize) -> Result<Vec<[f32; 3]>, VerifyError> {
        let shape = self.shape(name, 3)?;
        if shape[2] != 3 {
            return Err(self.error(name, format!("has shape {shape:?}, expected [B, N, 3]")));
        }
        Ok(self.item(name, 3, b, batch)?.as_chunks::<3>().0.to_vec())
    }

    /// Item `b` of pixel indices `[B, N]` below `limit`.
    pub(super) fn choose(
        &self,
        name: &str,
        b: usize,
        batch: usize,
        limit: usize,
    ) -> Result<Vec<u32>, VerifyError> {
        let tensor = self.get(name, 2, Some(batch))?;
        let n = tensor.shape[1];
        let values = &tensor.values[b * n..(b + 1) * n];
        match values.iter().find(|v| !(0.0..limit as f64).contains(*v)) {
            Some(value) => Err(self.error(name, format!("contains {value}, expected pixels in 0..{limit}"))),
            None => Ok(values.iter().map(|&v| v as u32).collect()),
        }
    }

    /// Item `b` of poses `[B, 3, 3]` and `[B, 3]`.
    pub(super) fn pose(
        &self,
        rotation: &str,
        translation: &str,
        b: usize,
        batch: usize,
    ) -> Result<Pose, VerifyError> {
        let numbers = |name: &str, rank| -> Result<Vec<f64>, VerifyError> {
            Ok(self.item(name, rank, b, batch)?.into_iter().map(f64::from).collect())
        };
        let (r, t) = (numbers(rotation, 3)?, numbers(translation, 2)?);
        match (r.first_chunk::<9>(), t.first_chunk::<3>()) {
            (Some(r), Some(t)) => Ok(Pose::from_row_major(r, t)),
            _ => Err(self.error(rotation, "and its translation are no [B, 3, 3] and [B, 3]".into())),
        }
    }
}
