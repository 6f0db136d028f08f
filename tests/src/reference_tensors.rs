//! Reference tensors of the official implementation: small files in `tests/fixtures`, large ones in the shared folder.

use std::path::PathBuf;

use safetensors::{Dtype, SafeTensors};

/// One file of reference tensors.
pub struct ReferenceTensors {
    bytes: Vec<u8>,
    path: PathBuf,
}

impl ReferenceTensors {
    /// The file `name.safetensors`, committed or in the shared folder.
    pub fn open(name: &str) -> Self {
        let file = format!("{name}.safetensors");
        let own = crate::fixture(&file);
        let path = if own.is_file() { own } else { crate::shared("fixtures").join(&file) };
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self { bytes, path }
    }

    fn tensor<T>(&self, name: &str, dtype: Dtype, parse: impl Fn(&[u8]) -> T) -> (Vec<usize>, Vec<T>) {
        let file = SafeTensors::deserialize(&self.bytes).unwrap();
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{}: {name}: {e}", self.path.display()));
        assert_eq!(view.dtype(), dtype, "{}: {name}", self.path.display());
        let width = view.data().len() / view.shape().iter().product::<usize>().max(1);
        (view.shape().to_vec(), view.data().chunks_exact(width.max(1)).map(parse).collect())
    }

    /// Shape and values of an `f32` tensor.
    pub fn f32(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        self.tensor(name, Dtype::F32, |b| f32::from_le_bytes(b.try_into().unwrap()))
    }

    /// Shape and values of an integer or boolean tensor.
    pub fn int(&self, name: &str) -> (Vec<usize>, Vec<i64>) {
        let dtype = SafeTensors::deserialize(&self.bytes).unwrap().tensor(name).unwrap().dtype();
        self.tensor(name, dtype, |b| match b.len() {
            1 => b[0] as i64,
            4 => i32::from_le_bytes(b.try_into().unwrap()) as i64,
            _ => i64::from_le_bytes(b.try_into().unwrap()),
        })
    }

    /// Item `i` of the batch of an `f32` tensor.
    pub fn item(&self, name: &str, i: usize) -> Vec<f32> {
        let (shape, values) = self.f32(name);
        let len = values.len() / shape[0];
        values[i * len..(i + 1) * len].to_vec()
    }

    /// Item `i` of the batch of an integer tensor.
    pub fn int_item(&self, name: &str, i: usize) -> Vec<i64> {
        let (shape, values) = self.int(name);
        let len = values.len() / shape[0];
        values[i * len..(i + 1) * len].to_vec()
    }

    /// Item `i` of a batch of clouds `[B, N, 3]`.
    pub fn cloud(&self, name: &str, i: usize) -> Vec<[f32; 3]> {
        self.item(name, i).as_chunks::<3>().0.to_vec()
    }

    /// Number of items in the batch.
    pub fn batch(&self, name: &str) -> usize {
        SafeTensors::deserialize(&self.bytes).unwrap().tensor(name).unwrap().shape()[0]
    }

    /// Names of all tensors.
    pub fn names(&self) -> Vec<String> {
        let file = SafeTensors::deserialize(&self.bytes).unwrap();
        file.names().into_iter().map(str::to_owned).collect()
    }

    /// Whether the file holds a tensor.
    pub fn contains(&self, name: &str) -> bool {
        SafeTensors::deserialize(&self.bytes).unwrap().tensor(name).is_ok()
    }
}

/// Largest absolute difference of two lists of the same length.
pub fn max_difference(got: impl IntoIterator<Item = f32>, expected: &[f32]) -> f32 {
    let mut count = 0;
    let worst = got.into_iter().zip(expected).fold(0.0f32, |worst, (a, b)| {
        count += 1;
        let d = (a - b).abs();
        if d.is_nan() { f32::INFINITY } else { worst.max(d) }
    });
    assert_eq!(count, expected.len(), "number of values");
    worst
}
