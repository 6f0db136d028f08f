//! What our network gives for the names of a file of reference tensors.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use unopose_core::geometry::Pose;
use unopose_infer::InferError;

use super::VerifyError;

/// One computed tensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Values {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
    /// Entries that are determined and so compared; empty: all.
    pub compared: Vec<bool>,
}

/// Computed tensors by name.
#[derive(Default)]
pub(super) struct Computed(pub BTreeMap<String, Values>);

impl Computed {
    /// A tensor of the device.
    pub(crate) fn tensor<const D: usize>(
        &mut self,
        name: impl Into<String>,
        tensor: Tensor<D>,
    ) -> Result<(), VerifyError> {
        let shape = tensor.dims().to_vec();
        let values = read(tensor)?.into_iter().map(f64::from).collect();
        self.0.insert(name.into(), Values { shape, values, compared: Vec::new() });
        Ok(())
    }

    /// A batch of host values, the items of equal length; `shape` is that of one item.
    pub(crate) fn items<T: Into<f64>>(
        &mut self,
        name: impl Into<String>,
        shape: &[usize],
        items: impl IntoIterator<Item = impl IntoIterator<Item = T>>,
    ) {
        let (mut batch, mut values) = (0, Vec::new());
        for item in items {
            values.extend(item.into_iter().map(Into::into));
            batch += 1;
        }
        let shape = [&[batch], shape].concat();
        self.0.insert(name.into(), Values { shape, values, compared: Vec::new() });
    }

    /// A batch of clouds.
    pub(crate) fn clouds<'a>(&mut self, name: &str, clouds: impl IntoIterator<Item = &'a [[f32; 3]]>) {
        let clouds: Vec<&[[f32; 3]]> = clouds.into_iter().collect();
        let n = clouds.first().map_or(0, |c| c.len());
        self.items(name, &[n, 3], clouds.iter().map(|c| c.as_flattened().iter().copied()));
    }

    /// A batch of poses as `prefix` + `R` and `t`.
    pub(crate) fn poses<'a>(&mut self, prefix: &str, poses: impl Iterator<Item = &'a Pose> + Clone) {
        self.items(format!("{prefix}R"), &[3, 3], poses.clone().map(|p| p.rotation_row_major()));
        self.items(
            format!("{prefix}t"),
            &[3],
            poses.map(|p| p.translation.iter().copied().collect::<Vec<_>>()),
        );
    }

    /// Compares only the items (first axes) where `determined` is true.
    pub(crate) fn restrict(&mut self, name: &str, determined: &[bool]) {
        if let Some(values) = self.0.get_mut(name) {
            let each = values.values.len() / determined.len().max(1);
            values.compared = determined.iter().flat_map(|&d| std::iter::repeat_n(d, each)).collect();
        }
    }
}

/// Values of a tensor on the host.
pub(super) fn read<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, VerifyError> {
    tensor
        .try_into_vec_as::<f32>()
        .map_err(|e| InferError::Readback { what: "tensors", message: e.to_string() }.into())
}
