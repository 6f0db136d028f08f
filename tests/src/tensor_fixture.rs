//! Reference tensors as tensors, and modules with stored weights.

use std::collections::BTreeMap;

use burn::{
    module::Module,
    tensor::{Device, Tensor, TensorData},
};
use unopose_core::config::ModelConfig;
use unopose_nn::checkpoint::{TensorFile, load_into};

use super::{
    reference_tensors::{ReferenceTensors, max_difference},
    test_device::test_device,
};

/// A file of reference tensors on the device under test.
pub struct Fixture {
    pub file: ReferenceTensors,
    pub device: Device,
}

impl Fixture {
    pub fn open(name: &str) -> Self {
        Self { file: ReferenceTensors::open(name), device: test_device() }
    }

    pub fn tensor<const D: usize>(&self, name: &str) -> Tensor<D> {
        let (shape, values) = self.file.f32(name);
        Tensor::from_data(TensorData::new(values, shape), &self.device)
    }

    /// `module` with the weights under `prefix`; a weight that is missing or too many fails.
    pub fn weights<M: Module>(&self, module: M, prefix: &str) -> M {
        let mut tensors = BTreeMap::new();
        for name in self.file.names() {
            let Some(key) = name.strip_prefix(prefix) else { continue };
            if key.ends_with("num_batches_tracked") || key == "embedding.div_term" {
                continue;
            }
            let (mut shape, values) = self.file.f32(&name);
            if key.ends_with("conv.weight") {
                shape.truncate(2);
            }
            tensors.insert(key.to_owned(), TensorData::new(values, shape));
        }
        let metadata = [("format_version", "1"), ("step", "0")].map(|(k, v)| (k.to_owned(), v.to_owned()));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("module.safetensors");
        TensorFile { tensors, metadata: metadata.into() }.write(&path).unwrap();
        load_into(&path, module, &ModelConfig::default()).unwrap().0
    }

    #[track_caller]
    pub fn check<const D: usize>(&self, name: &str, got: Tensor<D>, tolerance: f32) {
        let (shape, expected) = self.file.f32(name);
        assert_eq!(got.dims().iter().product::<usize>(), shape.iter().product::<usize>(), "{name}");
        let worst = max_difference(got.inner().try_into_vec_as::<f32>().unwrap(), &expected);
        println!("{name}: {worst:.1e} (tolerance {tolerance:.0e})");
        assert!(worst <= tolerance, "{name}: {worst:e} > {tolerance:e}");
    }
}
