//! Named tensors of a file as they are stored, from safetensors and from PyTorch's zip, tar and legacy pickles.

use std::{io::Read, path::Path};

use burn::{
    store::pytorch_reader::{DType as PickledType, PickleValue, PytorchReader},
    tensor::DType,
};
use safetensors::{Dtype, SafeTensors};

use super::super::CheckpointError;

/// A tensor before any conversion.
pub(super) struct Stored {
    pub name: String,
    pub shape: Vec<usize>,
    pub dtype: DType,
    /// Little-endian, row-major.
    pub bytes: Vec<u8>,
}

/// First parts of the official names.
const PARTS: [&str; 4] =
    ["feature_extraction.", "geo_embedding.", "coarse_point_matching.", "fine_point_matching."];

/// Where the state of the network may lie inside a pickled file.
const PLACES: [&str; 7] =
    ["", "model.", "state_dict.", "model_state_dict.", "module.", "model.module.", "state_dict.module."];

/// All tensors of the network's state in `path`, with notices about the rest of the file.
pub(super) fn read(path: &Path) -> Result<(Vec<Stored>, Vec<String>), CheckpointError> {
    let mut start = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(9).read_to_end(&mut start))
        .map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
    // A safetensors file opens with the length of its JSON header.
    if start.get(8) == Some(&b'{') { Ok((safetensors(path)?, Vec::new())) } else { pickled(path) }
}

fn safetensors(path: &Path) -> Result<Vec<Stored>, CheckpointError> {
    let bytes =
        std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
    let file = SafeTensors::deserialize(&bytes)
        .map_err(|e| CheckpointError::Format { path: path.to_owned(), message: e.to_string() })?;
    file.iter()
        .map(|(name, view)| {
            let dtype = match view.dtype() {
                Dtype::F64 => DType::F64,
                Dtype::F32 => DType::F32,
                Dtype::F16 => DType::F16,
                Dtype::BF16 => DType::BF16,
                Dtype::I64 => DType::I64,
                Dtype::I32 => DType::I32,
                Dtype::U8 | Dtype::BOOL => DType::U8,
                other => {
                    return Err(CheckpointError::Tensor {
                        path: path.to_owned(),
                        name: name.to_owned(),
                        message: format!("type is {other:?}, expected F32, F16, BF16 or F64"),
                    });
                }
            };
            Ok(Stored {
                name: name.to_owned(),
                shape: view.shape().to_vec(),
                dtype,
                bytes: view.data().to_vec(),
            })
        })
        .collect()
}

fn pickled(path: &Path) -> Result<(Vec<Stored>, Vec<String>), CheckpointError> {
    let error = |message: String| CheckpointError::Pytorch { path: path.to_owned(), message };
    let tensors = PytorchReader::new(path).map_err(|e| error(e.to_string()))?.into_tensors();
    let place = PLACES.iter().find(|place| {
        tensors.keys().any(|name| {
            name.strip_prefix(**place).is_some_and(|rest| PARTS.iter().any(|part| rest.starts_with(part)))
        })
    });
    let Some(place) = place else {
        let mut names: Vec<&String> = tensors.keys().collect();
        names.sort();
        let found = match names[..] {
            [] => contents(path),
            [first, ..] => format!("{} tensors, the first is {first}", names.len()),
        };
        return Err(error(format!(
            "no state of the network at its top level or under model or state_dict, expected names like \
             coarse_point_matching.in_proj.weight; found {found}"
        )));
    };
    let (mut stored, mut others) = (Vec::new(), 0);
    for (path_inside, tensor) in tensors {
        let Some(name) = path_inside.strip_prefix(place) else {
            others += 1;
            continue;
        };
        let dtype = match tensor.dtype() {
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
        };
        let shape = tensor.shape().to_vec();
        let bytes = tensor.read().map_err(|e| error(e.to_string()))?;
        stored.push(Stored { name: name.to_owned(), shape, dtype, bytes });
    }
    let notice = (others > 0)
        .then(|| format!("{others} tensors outside {place}* left out (optimizer state and the like)"));
    Ok((stored, notice.into_iter().collect()))
}

/// What a pickle without tensors holds, by the Python types of its entries.
fn contents(path: &Path) -> String {
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
