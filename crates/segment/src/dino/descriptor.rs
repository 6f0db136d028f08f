//! The tokens that describe a masked view, and how alike two views are by them.

use burn::tensor::{Device, Tensor, TensorData};
use unopose_infer::InferError;

use super::crop::Crop;

/// Keeps the mean over no patch finite.
const EPSILON: f64 = 1e-6;

/// A masked view as the transformer describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Descriptor {
    /// Class token, of length 1, `[C]`.
    class: Vec<f32>,
    /// Tokens of the patches that are more than half inside the mask, of length 1, `[P, C]`.
    patches: Vec<f32>,
    /// There are other patches; their tokens count as zero, which is like nothing.
    background: bool,
}

impl Descriptor {
    /// From the crop and what the transformer makes of it: class token `[C]`, tokens of all patches `[.., C]`.
    pub fn new(crop: &Crop, patch: usize, class: &[f32], tokens: &[f32]) -> Self {
        let inside = crop.patches(patch);
        let kept = tokens.chunks_exact(class.len()).zip(&inside).filter(|(_, inside)| **inside);
        Self {
            class: unit(class).collect(),
            patches: kept.flat_map(|(token, _)| unit(token)).collect(),
            background: inside.contains(&false),
        }
    }

    fn patch_count(&self) -> usize {
        self.patches.len() / self.class.len().max(1)
    }

    fn patch_tensor(&self, device: &Device) -> Tensor<2> {
        let shape = [self.patch_count(), self.class.len()];
        Tensor::from_data(TensorData::new(self.patches.clone(), shape), device)
    }
}

fn unit(token: &[f32]) -> impl Iterator<Item = f32> {
    let norm = token.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-12);
    token.iter().map(move |x| x / norm)
}

/// The described proposals of an image, to be compared with many views.
pub struct Queries<'a> {
    descriptors: &'a [Option<Descriptor>],
    /// All their patch tokens one after the other, `[sum of P, C]`; `None` when there are none.
    patches: Option<Tensor<2>>,
    device: &'a Device,
}

impl<'a> Queries<'a> {
    /// `None` stands for a proposal that shows nothing and is like nothing.
    pub fn new(descriptors: &'a [Option<Descriptor>], device: &'a Device) -> Self {
        let parts = descriptors.iter().flatten().filter(|d| !d.patches.is_empty());
        let parts: Vec<Tensor<2>> = parts.map(|d| d.patch_tensor(device)).collect();
        let patches = (!parts.is_empty()).then(|| Tensor::cat(parts, 0));
        Self { descriptors, patches, device }
    }

    /// The score of every proposal against a view: the mean of the cosine of the class tokens and of the mean, over the
    /// proposal's patches, of the best cosine to any of the view's. Both are clamped to [0, 1].
    pub fn scores(&self, view: &Descriptor) -> Result<Vec<f64>, InferError> {
        let mut best = self.best_of_patches(view)?.into_iter();
        let score = |query: &Option<Descriptor>| {
            let Some(query) = query else { return 0.0 };
            let global: f64 = query.class.iter().zip(&view.class).map(|(a, b)| f64::from(a * b)).sum();
            let count = query.patch_count();
            let total: f64 = best.by_ref().take(count).map(f64::from).sum();
            let local = total / (count as f64 + EPSILON);
            0.5 * (global.clamp(0.0, 1.0) + local.clamp(0.0, 1.0))
        };
        Ok(self.descriptors.iter().map(score).collect())
    }

    /// Of every patch of all proposals, the best cosine to a patch of the view.
    fn best_of_patches(&self, view: &Descriptor) -> Result<Vec<f32>, InferError> {
        let Some(patches) = &self.patches else { return Ok(Vec::new()) };
        if view.patches.is_empty() {
            return Ok(vec![0.0; patches.dims()[0]]);
        }
        let cosines = patches.clone().matmul(view.patch_tensor(self.device).transpose()); // [sum of P, P of the view]
        let mut best = cosines
            .max_dim(1)
            .try_into_vec_as::<f32>()
            .map_err(InferError::readback("cosines of patch tokens"))?;
        if view.background {
            best.iter_mut().for_each(|cosine| *cosine = cosine.max(0.0));
        }
        Ok(best)
    }
}
