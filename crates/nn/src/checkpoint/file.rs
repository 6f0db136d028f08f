//! The safetensors file: named f32 arrays, string metadata, and a checksum of both.

use std::{
    collections::{BTreeMap, HashMap},
    io::Write,
    path::Path,
};

use burn::tensor::{DType, TensorData, f16};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use unopose_core::files::{read_regular, write_atomic};

use super::CheckpointError;

/// Metadata entry with the CRC-32 of the other entries and of all tensors' names, shapes and stored bytes.
const CHECKSUM: &str = "checksum";

/// Metadata entry of a file whose values were rounded to half precision on purpose.
const HALVES: &str = "half_precision";

/// Contents of a checkpoint file on the host.
pub struct TensorFile {
    /// Values by name.
    pub tensors: BTreeMap<String, TensorData>,
    /// The header's `__metadata__`, without the checksum.
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Reads all tensors as f32; other precisions are converted, with a warning in the log. A file whose contents differ
    /// from its checksum is refused; files of other programs have none.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = read_regular(path, u64::MAX)
            .map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes, path)
    }

    /// [`Self::read`] of a file that is already in memory; `path` is only for messages.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, CheckpointError> {
        let format = |e: safetensors::SafeTensorError| CheckpointError::Format {
            path: path.to_owned(),
            message: e.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(format)?;
        let mut metadata: BTreeMap<String, String> =
            header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
        let file = SafeTensors::deserialize(bytes).map_err(format)?;
        if let Some(stored) = metadata.remove(CHECKSUM) {
            let views: BTreeMap<&str, TensorView<'_>> = file.iter().collect();
            let computed = checksum(&metadata, views.iter().map(|(name, view)| (*name, view)));
            if stored != computed {
                return Err(CheckpointError::Damaged { path: path.to_owned(), stored, computed });
            }
        }
        let mut tensors = BTreeMap::new();
        let mut converted: BTreeMap<String, usize> = BTreeMap::new();
        for (name, view) in file.iter() {
            tensors.insert(name.to_owned(), read_tensor(path, name, &view)?);
            if view.dtype() != Dtype::F32 {
                *converted.entry(format!("{:?}", view.dtype())).or_default() += 1;
            }
        }
        let on_purpose = metadata.contains_key(HALVES);
        for (dtype, count) in converted.into_iter().filter(|_| !on_purpose) {
            tracing::warn!("{}: {count} tensors converted from {dtype} to F32", path.display());
        }
        Ok(Self { tensors, metadata })
    }

    /// Writes the file with its checksum, in one rename: readers see the old file or the new one, never a part.
    pub fn write(&self, path: &Path) -> Result<(), CheckpointError> {
        self.write_as(path, Dtype::F32)
    }

    /// [`Self::write`] with all values rounded to half precision, for networks that do not notice it. Values beyond 65504, the
    /// largest half-precision number, are an error.
    pub fn write_half(mut self, path: &Path) -> Result<(), CheckpointError> {
        for (name, data) in &mut self.tensors {
            *data = data.clone().convert::<f16>();
            if data.iter::<f32>().any(|value| !value.is_finite()) {
                let message = "has a value beyond 65504, expected one that half precision can hold".into();
                return Err(CheckpointError::Tensor { path: path.to_owned(), name: name.clone(), message });
            }
        }
        self.metadata.insert(HALVES.into(), "true".into());
        self.write_as(path, Dtype::F16)
    }

    /// Values are stored as `dtype` already.
    fn write_as(&self, path: &Path, dtype: Dtype) -> Result<(), CheckpointError> {
        let views: Vec<(&String, TensorView<'_>)> = self
            .tensors
            .iter()
            .map(|(name, data)| {
                let view = TensorView::new(dtype, data.shape().to_vec(), data.as_bytes());
                view.map(|view| (name, view)).map_err(|e| CheckpointError::Tensor {
                    path: path.to_owned(),
                    name: name.clone(),
                    message: e.to_string(),
                })
            })
            .collect::<Result<_, _>>()?;
        let checksum = checksum(&self.metadata, views.iter().map(|(name, view)| (name.as_str(), view)));
        let mut metadata: HashMap<String, String> = self.metadata.clone().into_iter().collect();
        metadata.insert(CHECKSUM.into(), checksum);
        let format = |message: String| CheckpointError::Format { path: path.to_owned(), message };
        let bytes = safetensors::serialize(views, Some(metadata)).map_err(|e| format(e.to_string()))?;
        let (header, values) = sorted_header(&bytes).ok_or_else(|| format("no header was written".into()))?;
        Ok(write_atomic(path, |writer| {
            writer.write_all(&(header.len() as u64).to_le_bytes())?;
            writer.write_all(&header)?;
            writer.write_all(values)
        })?)
    }
}

/// The header with its entries in order, so that equal contents are equal files, and the bytes behind it.
fn sorted_header(file: &[u8]) -> Option<(Vec<u8>, &[u8])> {
    const METADATA: &str = "__metadata__";
    let (length, rest) = file.split_first_chunk::<8>()?;
    let (header, values) = rest.split_at_checked(u64::from_le_bytes(*length) as usize)?;
    let mut entries: BTreeMap<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
    if let Some(metadata) = entries.remove(METADATA) {
        let metadata: BTreeMap<String, String> = serde_json::from_value(metadata).ok()?;
        entries.insert(METADATA.into(), serde_json::to_value(metadata).ok()?);
    }
    let mut header = serde_json::to_vec(&entries).ok()?;
    // Values begin at multiples of eight bytes.
    header.resize(header.len().next_multiple_of(8), b' ');
    Some((header, values))
}

/// See [`CHECKSUM`]; `tensors` in the order of their names.
fn checksum<'a, 'b: 'a>(
    metadata: &BTreeMap<String, String>,
    tensors: impl Iterator<Item = (&'a str, &'a TensorView<'b>)>,
) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for (key, value) in metadata {
        hasher.update(format!("{key}\0{value}\0").as_bytes());
    }
    for (name, view) in tensors {
        hasher.update(format!("{name}\0{:?}\0{:?}\0", view.dtype(), view.shape()).as_bytes());
        hasher.update(view.data());
    }
    format!("crc32:{:08x}", hasher.finalize())
}

fn read_tensor(path: &Path, name: &str, view: &TensorView<'_>) -> Result<TensorData, CheckpointError> {
    let dtype = match view.dtype() {
        Dtype::F64 => DType::F64,
        Dtype::F32 => DType::F32,
        Dtype::F16 => DType::F16,
        Dtype::BF16 => DType::BF16,
        other => return Err(wrong_type(path, name, &format!("{other:?}"))),
    };
    as_f32(path, name, view.data().to_vec(), view.shape().to_vec(), dtype)
}

/// Stored bytes (little-endian) as finite f32.
pub(super) fn as_f32(
    path: &Path,
    name: &str,
    bytes: Vec<u8>,
    shape: Vec<usize>,
    dtype: DType,
) -> Result<TensorData, CheckpointError> {
    if !matches!(dtype, DType::F64 | DType::F32 | DType::F16 | DType::BF16) {
        return Err(wrong_type(path, name, &format!("{dtype:?}")));
    }
    let error =
        |message: String| CheckpointError::Tensor { path: path.to_owned(), name: name.to_owned(), message };
    let data = TensorData::from_bytes_vec(bytes, shape, dtype).convert::<f32>();
    match data.as_slice::<f32>() {
        Ok(values) if values.iter().all(|v| v.is_finite()) => Ok(data),
        Ok(_) => Err(error("contains NaN or infinity".into())),
        Err(e) => Err(error(format!("{e:?}"))),
    }
}

fn wrong_type(path: &Path, name: &str, dtype: &str) -> CheckpointError {
    CheckpointError::Tensor {
        path: path.to_owned(),
        name: name.to_owned(),
        message: format!("type is {dtype}, expected F32, F16, BF16 or F64"),
    }
}
