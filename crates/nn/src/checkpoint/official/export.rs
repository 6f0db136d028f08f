//! Our networks as official state files.

use std::{borrow::Cow, collections::HashMap, io::Write, path::Path};

use burn::tensor::TensorData;
use safetensors::{Dtype, View};
use unopose_core::{
    config::{ColorConfig, ModelConfig, OverlapMode},
    files::write_atomic,
};

use super::super::{CheckpointError, tensors_of};
use crate::model::UnoPose;

/// One tensor of the file.
struct Entry {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl View for Entry {
    fn dtype(&self) -> Dtype {
        self.dtype
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

/// Writes `model` to `path` as safetensors under the official names and in the official shapes, with the constants that
/// the release keeps in its state (`div_term`, `num_batches_tracked`). Its unused heads (`vit.head`, `dis_proj`) do not
/// exist here and are not written. A network that the release cannot hold is refused.
pub fn export_official(path: &Path, model: &UnoPose, config: &ModelConfig) -> Result<(), CheckpointError> {
    if let Some(reason) = without_counterpart(config) {
        return Err(CheckpointError::NoCounterpart { reason });
    }
    let mut entries: HashMap<String, Entry> = HashMap::new();
    for (name, data) in tensors_of(model, path)? {
        let mut shape = data.shape().to_vec();
        if name.contains(".PE.") && name.ends_with(".conv.weight") {
            // The shared layers are 2-D convolutions, the last map a 1-D one.
            shape.extend(if name.contains(".mlp3.") { [1].as_slice() } else { &[1, 1] });
        }
        if let Some(norm) = name.strip_suffix(".bn.running_var") {
            let count = Entry { dtype: Dtype::I64, shape: Vec::new(), bytes: vec![0; 8] };
            entries.insert(format!("{norm}.bn.num_batches_tracked"), count);
        }
        entries.insert(name, Entry { dtype: Dtype::F32, shape, bytes: data.as_bytes().to_vec() });
    }
    let width = config.geo_embedding.hidden_dim;
    let div_term = div_term(width);
    entries.insert(
        "geo_embedding.embedding.div_term".into(),
        Entry { dtype: Dtype::F32, shape: vec![width / 2], bytes: div_term.as_bytes().to_vec() },
    );
    let metadata = HashMap::from([("format".to_owned(), "pt".to_owned())]);
    let bytes = safetensors::serialize(entries, Some(metadata))
        .map_err(|e| CheckpointError::Format { path: path.to_owned(), message: e.to_string() })?;
    Ok(write_atomic(path, |writer| writer.write_all(&bytes))?)
}

/// Frequencies of the sinusoids.
fn div_term(width: usize) -> TensorData {
    let step = -(10000f64.ln()) / width as f64;
    let terms: Vec<f32> = (0..width / 2).map(|i| ((2 * i) as f64 * step).exp() as f32).collect();
    TensorData::new(terms, [width / 2])
}

/// Why the release has no network like this.
fn without_counterpart(config: &ModelConfig) -> Option<String> {
    match &config.color {
        ColorConfig::Vit(_) => {}
        ColorConfig::Conv { .. } => {
            return Some(
                "its colour encoder is convolutional (model.color.kind = conv), the release has a vision \
                 transformer only"
                    .into(),
            );
        }
        ColorConfig::Hybrid(_) => {
            return Some(
                "its colour encoder has convolutions before its transformer (model.color.kind = hybrid), the release has \
                 a vision transformer only"
                    .into(),
            );
        }
        ColorConfig::None { .. } => {
            return Some(
                "it has no colour encoder (model.color.kind = none), the release has a vision transformer only"
                    .into(),
            );
        }
    }
    if !config.use_fine {
        return Some("it has no fine stage (model.use_fine = false)".into());
    }
    if config.overlap != OverlapMode::Release {
        return Some(format!(
            "its overlap mode is {:?} (model.overlap), the release computes Release only",
            config.overlap
        ));
    }
    let heads = [config.coarse.heads, config.fine.matching.heads];
    (heads != [4, 4]).then(|| format!("its stages have {heads:?} attention heads, the release always 4"))
}
