//! Named tensors of a file as they are stored, from safetensors and from PyTorch's zip, tar and legacy pickles.

use std::{collections::HashMap, io::Read, path::Path};

use burn::{
    store::pytorch_reader::{DType as PickledType, PickleValue, PytorchReader, Tensor as PickledTensor},
    tensor::DType,
};
use safetensors::{Dtype, SafeTensors};

use super::{
    CheckpointError,
    claims::{check_archive, check_tensors},
};

/// A tensor before any conversion.
pub struct Stored {
    pub name: String,
    pub shape: Vec<usize>,
    pub dtype: DType,
    /// Little-endian, row-major.
    pub bytes: Vec<u8>,
}

/// How the tensors of one kind of network are found among others.
pub struct Layout {
    /// First parts of their names, one of which is enough.
    pub parts: &'static [&'static str],
    /// Prefixes that they may have.
    pub places: &'static [&'static str],
}

/// An opened file.
pub enum Container {
    Safetensors(Vec<u8>),
    /// And the file's length in bytes.
    Pickled(HashMap<String, PickledTensor>, u64),
}

impl Container {
    /// Opens a file; its content decides what it is, not its name.
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        let read = |source| CheckpointError::Read { path: path.to_owned(), source };
        let mut start = Vec::new();
        std::fs::File::open(path).and_then(|file| file.take(9).read_to_end(&mut start)).map_err(read)?;
        // A safetensors file opens with the length of its JSON header.
        if start.get(8) == Some(&b'{') {
            let bytes = std::fs::read(path).map_err(read)?;
            SafeTensors::deserialize(&bytes).map_err(|e| format(path, &e))?;
            return Ok(Self::Safetensors(bytes));
        }
        let length = check_archive(path)?;
        let reader = PytorchReader::new(path).map_err(|e| pytorch(path, e.to_string()))?;
        Ok(Self::Pickled(reader.into_tensors(), length))
    }

    /// Names of all tensors, sorted.
    pub fn names(&self, path: &Path) -> Result<Vec<String>, CheckpointError> {
        let mut names: Vec<String> = match self {
            Self::Safetensors(bytes) => {
                let file = SafeTensors::deserialize(bytes).map_err(|e| format(path, &e))?;
                file.names().into_iter().map(str::to_owned).collect()
            }
            Self::Pickled(tensors, _) => tensors.keys().cloned().collect(),
        };
        names.sort();
        Ok(names)
    }

    fn shape(&self, path: &Path, name: &str) -> Result<Vec<usize>, CheckpointError> {
        match self {
            Self::Safetensors(bytes) => {
                let file = SafeTensors::deserialize(bytes).map_err(|e| format(path, &e))?;
                let view = file.tensor(name).map_err(|e| format(path, &e))?;
                Ok(view.shape().to_vec())
            }
            Self::Pickled(tensors, _) => {
                Ok(tensors.get(name).map(|t| t.shape().to_vec()).unwrap_or_default())
            }
        }
    }

    /// The prefix under which the file has tensors of this layout.
    pub fn place(&self, path: &Path, layout: &Layout) -> Result<Option<&'static str>, CheckpointError> {
        let names = self.names(path)?;
        let holds = |place: &&&str| {
            names.iter().any(|name| {
                name.strip_prefix(**place)
                    .is_some_and(|rest| layout.parts.iter().any(|part| rest.starts_with(part)))
            })
        };
        Ok(layout.places.iter().find(holds).copied())
    }

    /// The tensors under `place`, without it, and notices about the others.
    pub fn read(self, path: &Path, place: &str) -> Result<(Vec<Stored>, Vec<String>), CheckpointError> {
        let (mut stored, mut others) = (Vec::new(), 0);
        match self {
            Self::Safetensors(bytes) => {
                let file = SafeTensors::deserialize(&bytes).map_err(|e| format(path, &e))?;
                for (name, view) in file.iter() {
                    let Some(name) = name.strip_prefix(place) else {
                        others += 1;
                        continue;
                    };
                    let dtype = safe_type(view.dtype()).ok_or_else(|| CheckpointError::Tensor {
                        path: path.to_owned(),
                        name: name.to_owned(),
                        message: format!("type is {:?}, expected F32, F16, BF16 or F64", view.dtype()),
                    })?;
                    let (name, shape) = (name.to_owned(), view.shape().to_vec());
                    stored.push(Stored { name, shape, dtype, bytes: view.data().to_vec() });
                }
            }
            Self::Pickled(tensors, length) => {
                let wanted = tensors.iter().filter(|(name, _)| name.starts_with(place));
                check_tensors(path, wanted.map(|(_, tensor)| tensor), length)?;
                for (name, tensor) in tensors {
                    let Some(name) = name.strip_prefix(place) else {
                        others += 1;
                        continue;
                    };
                    let (dtype, shape) = (pickled_type(tensor.dtype()), tensor.shape().to_vec());
                    let bytes = tensor.read().map_err(|e| pytorch(path, e.to_string()))?;
                    stored.push(Stored { name: name.to_owned(), shape, dtype, bytes });
                }
            }
        }
        stored.sort_by(|a, b| a.name.cmp(&b.name));
        let notice = (others > 0)
            .then(|| format!("{others} tensors outside {place}* left out (optimizer state and the like)"));
        Ok((stored, notice.into_iter().collect()))
    }

    /// What the file holds, for a message about what it does not hold.
    pub fn describe(&self, path: &Path) -> String {
        match (self.names(path), self) {
            (Ok(names), _) if !names.is_empty() => {
                let shape = self.shape(path, &names[0]).unwrap_or_default();
                format!("{} tensors, the first is {} {shape:?}", names.len(), names[0])
            }
            (_, Self::Safetensors(_)) => "no tensors".into(),
            (_, Self::Pickled(..)) => pickled_contents(path),
        }
    }
}

fn format(path: &Path, error: &safetensors::SafeTensorError) -> CheckpointError {
    CheckpointError::Format { path: path.to_owned(), message: error.to_string() }
}

fn pytorch(path: &Path, message: String) -> CheckpointError {
    CheckpointError::Pytorch { path: path.to_owned(), message }
}

fn safe_type(dtype: Dtype) -> Option<DType> {
    Some(match dtype {
        Dtype::F64 => DType::F64,
        Dtype::F32 => DType::F32,
        Dtype::F16 => DType::F16,
        Dtype::BF16 => DType::BF16,
        Dtype::I64 => DType::I64,
        Dtype::I32 => DType::I32,
        Dtype::U8 | Dtype::BOOL => DType::U8,
        _ => return None,
    })
}

fn pickled_type(dtype: PickledType) -> DType {
    match dtype {
        PickledType::F64 => DType::F64,
        PickledType::F32 => DType::F32,
        PickledType::F16 => DType::F16,
        PickledType::BF16 => DType::BF16,
        PickledType::I64 => DType::I64,
        PickledType::I32 => DType::I32,
        PickledType::I16 => DType::I16,
        PickledType::I8 => DType::I8,
        PickledType::U64 => DType::U64,
        PickledType::U32 => DType::U32,
        PickledType::U16 => DType::U16,
        PickledType::U8 | PickledType::Bool => DType::U8,
    }
}

/// What a pickle without tensors holds, by the Python types of its entries.
fn pickled_contents(path: &Path) -> String {
    let kind = |value: &PickleValue| match value {
        PickleValue::Unsupported(class) => class.clone(),
        PickleValue::Dict(entries) => format!("dict of {}", entries.len()),
        PickleValue::List(items) => format!("list of {}", items.len()),
        PickleValue::None => "None".into(),
        PickleValue::Bool(_) => "bool".into(),
        PickleValue::Int(_) => "int".into(),
        PickleValue::Float(_) => "float".into(),
        PickleValue::String(_) => "str".into(),
        PickleValue::Bytes(_) => "bytes".into(),
    };
    match PytorchReader::read_pickle_data(path, None) {
        Ok(PickleValue::Dict(entries)) if !entries.is_empty() => {
            let mut lines: Vec<String> = entries.iter().map(|(k, v)| format!("{k}: {}", kind(v))).collect();
            lines.sort();
            let more = lines.len().saturating_sub(8);
            lines.truncate(8);
            let more = if more > 0 { format!(" and {more} more entries") } else { String::new() };
            format!("no tensors but {}{more}", lines.join(", "))
        }
        Ok(value) => format!("no tensors but {}", kind(&value)),
        Err(e) => format!("no tensors ({e})"),
    }
}
