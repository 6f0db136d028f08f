//! What the checkpoint's colour encoder says of a masked view, as one vector.

use burn::tensor::{Tensor, TensorData};
use rayon::prelude::*;
use unopose_core::frame::{Mask, RgbdFrame};
use unopose_nn::model::PixelChoice;
use unopose_pairs::data::prepare_query;

use super::{
    InferError, PoseEstimator,
    streams::{self, stream},
};

/// Views per forward pass.
const BATCH: usize = 16;
/// Radius of a view, metres: large enough for whatever a mask may show.
const REACH: f32 = 5.0;

impl PoseEstimator {
    /// Mean colour feature of the points of each mask; `None` where a mask has too few points.
    pub fn color_features(
        &self,
        frame: &RgbdFrame,
        masks: &[&Mask],
    ) -> Result<Vec<Option<Vec<f32>>>, InferError> {
        let prepare = |mask: &&Mask| {
            prepare_query(frame, mask, REACH, &self.config, &mut stream(self.seed, streams::COLOR_POINTS))
                .ok()
        };
        let prepared: Vec<_> = masks.par_iter().map(prepare).collect();
        let usable: Vec<_> = prepared.iter().flatten().collect();
        let mut features = Vec::with_capacity(usable.len());
        let side = self.config.image_size;
        for batch in usable.chunks(BATCH) {
            let images: Vec<f32> = batch.iter().flat_map(|cloud| cloud.rgb.iter().copied()).collect();
            let images =
                Tensor::<4>::from_data(TensorData::new(images, [batch.len(), 3, side, side]), &self.device);
            let choose = PixelChoice::new(batch.iter().map(|cloud| cloud.choose.as_slice()));
            let mean = self.model.feature_extraction.forward(images, &choose).mean_dim(1); // [B, 1, C]
            let width = mean.dims()[2].max(1);
            let values = mean.try_into_vec_as::<f32>().map_err(InferError::readback("colour features"))?;
            features.extend(values.chunks_exact(width).map(<[f32]>::to_vec));
        }
        let mut features = features.into_iter();
        Ok(prepared.iter().map(|cloud| cloud.as_ref().and_then(|_| features.next())).collect())
    }
}
