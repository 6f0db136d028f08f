//! Matching by a DINOv2 transformer as UNOPose and CNOS do it: the class token and the patch tokens of the object's crop.
//!
//! [`Crop`] is the input of the transformer, [`Descriptor`] its output. The score of a proposal against an object with
//! several views (templates of its model) is the mean over its five best views.

mod crop;
mod descriptor;

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_infer::InferError;
use unopose_nn::{
    checkpoint::{checksum, load_transformer},
    device::DeviceChoice,
    model::VisionTransformer,
};

use super::{Comparison, Matcher, Proposal, SegmentError};
use crop::{Crop, SIDE};
use descriptor::{Descriptor, Queries};

/// Views per forward pass, which bounds memory.
const BATCH: usize = 8;
/// Best views of an object that count.
const BEST_VIEWS: usize = 5;

/// Compares by a DINOv2 transformer.
pub struct DinoMatcher {
    transformer: VisionTransformer,
    device: Device,
    name: String,
    /// Of the weights.
    checksum: u32,
}

/// The views of an object as [`DinoMatcher`] keeps them.
pub struct DinoObject {
    views: Vec<Descriptor>,
}

impl DinoMatcher {
    /// Reads published weights (ViT-S, B or L with or without registers, named as Meta, timm or Hugging Face name them).
    pub fn load(path: &Path, device: DeviceChoice) -> Result<Self, SegmentError> {
        let (device, _) = device.open()?;
        let transformer = load_transformer(path, SIDE, &device)?;
        let checksum = checksum(&transformer)?;
        Ok(Self { name: name(&transformer), transformer, device, checksum })
    }

    /// The descriptors of masked views; `None` for a mask without pixels in its image.
    fn describe(&self, views: &[MaskedView]) -> Result<Vec<Option<Descriptor>>, SegmentError> {
        let mut descriptors = Vec::with_capacity(views.len());
        for views in views.chunks(BATCH) {
            let crops: Vec<Option<Crop>> =
                views.par_iter().map(|view| Crop::new(&view.frame.rgb, view.mask)).collect();
            let seen: Vec<&Crop> = crops.iter().flatten().collect();
            let mut described = self.describe_crops(&seen)?.into_iter();
            descriptors.extend(crops.iter().map(|crop| crop.as_ref().and_then(|_| described.next())));
        }
        Ok(descriptors)
    }

    fn describe_crops(&self, crops: &[&Crop]) -> Result<Vec<Descriptor>, InferError> {
        if crops.is_empty() {
            return Ok(Vec::new());
        }
        let pixels: Vec<f32> = crops.iter().flat_map(|crop| crop.pixels.iter().copied()).collect();
        let images =
            Tensor::<4>::from_data(TensorData::new(pixels, [crops.len(), 3, SIDE, SIDE]), &self.device);
        let features = self.transformer.forward(images);
        let tokens = features.patch_tokens();
        let [_, patches, width] = tokens.dims();
        let read = InferError::readback("DINOv2 tokens");
        let class = features.class_token.try_into_vec_as::<f32>().map_err(&read)?;
        let tokens = tokens.try_into_vec_as::<f32>().map_err(&read)?;
        let of_crops = class.chunks_exact(width).zip(tokens.chunks_exact(patches * width));
        let patch = self.transformer.patch_size();
        let described = crops.iter().zip(of_crops);
        Ok(described.map(|(crop, (class, tokens))| Descriptor::new(crop, patch, class, tokens)).collect())
    }
}

impl Matcher for DinoMatcher {
    type Object = DinoObject;

    fn name(&self) -> String {
        self.name.clone()
    }

    fn fingerprint(&self) -> String {
        format!("dinov2 1 {BEST_VIEWS} {:08x}", self.checksum)
    }

    /// Half of the score of a view against itself; not checked with published weights.
    fn instance_score(&self) -> f64 {
        0.5
    }

    fn knows_absence(&self) -> bool {
        false
    }

    fn object(&self, views: &[MaskedView]) -> Result<DinoObject, SegmentError> {
        let unusable = |reason: &str| SegmentError::Reference { reason: reason.into() };
        if views.is_empty() {
            return Err(unusable("there is none"));
        }
        let described: Option<Vec<Descriptor>> = self.describe(views)?.into_iter().collect();
        Ok(DinoObject { views: described.ok_or_else(|| unusable("all of it is background"))? })
    }

    fn compare(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&DinoObject],
    ) -> Result<Vec<Vec<Comparison>>, SegmentError> {
        let views: Vec<MaskedView> =
            proposals.iter().map(|proposal| MaskedView { frame, mask: &proposal.mask }).collect();
        let described = self.describe(&views)?;
        let queries = Queries::new(&described, &self.device);
        let of_object = |object: &&DinoObject| -> Result<Vec<Comparison>, SegmentError> {
            let of_views: Vec<Vec<f64>> =
                object.views.iter().map(|view| queries.scores(view)).collect::<Result<_, _>>()?;
            let of_proposal = |p: usize| Comparison {
                score: mean_of_best(of_views.iter().map(|scores| scores[p]).collect()),
                t_query_reference: None,
            };
            Ok((0..proposals.len()).map(of_proposal).collect())
        };
        objects.iter().map(of_object).collect()
    }

    /// Nothing is known but likeness.
    fn recut(&self, _: &RgbdFrame, _: &Mask, _: &DinoObject, _: &Pose) -> Option<Mask> {
        None
    }
}

/// As Meta names its models: `dinov2-vits14`, `dinov2-vitb14-reg4`; others by width and depth.
fn name(transformer: &VisionTransformer) -> String {
    let [_, _, width] = transformer.cls_token.dims();
    let size = match (width, transformer.blocks.len()) {
        (384, 12) => "vits".into(),
        (768, 12) => "vitb".into(),
        (1024, 24) => "vitl".into(),
        (width, depth) => format!("vit-{width}x{depth}-"),
    };
    let registers = transformer.reg_token.as_ref().map(|tokens| format!("-reg{}", tokens.dims()[1]));
    format!("dinov2-{size}{}{}", transformer.patch_size(), registers.unwrap_or_default())
}

/// Mean of the [`BEST_VIEWS`] largest.
fn mean_of_best(mut scores: Vec<f64>) -> f64 {
    scores.sort_by(|a, b| b.total_cmp(a));
    scores.truncate(BEST_VIEWS);
    scores.iter().sum::<f64>() / scores.len().max(1) as f64
}

#[cfg(test)]
mod tests;
