//! Segment Anything and MobileSAM as a proposal generator: published weights, run by burn.
//!
//! [`SamProposals`] is the whole: automatic masks for a proposal list, or the mask of one point or box.
//! [`SamCheckpoint`] reads the published files; [`Sam`] is the network, one file per part. Its fields are named like the
//! published tensors (the original is Apache-2.0).

mod automatic;
mod conv_bn;
mod grid;
mod image_encoder;
mod layers;
mod mask_decoder;
mod mask_pixels;
mod network;
mod pillow;
mod prompt_encoder;
mod resize;
mod sizes;
mod tiny_vit;
mod two_way;
mod weights;

pub use mask_decoder::Decoded;
pub use mask_pixels::{Upscaling, stability};
pub use network::{ImageEmbedding, ImageEncoder, Sam};
pub use resize::ResizeLongestSide;
pub use sizes::SamSizes;
pub use weights::SamCheckpoint;

use std::path::Path;

use burn::tensor::Device;
use unopose_core::frame::RgbdFrame;
use unopose_nn::checkpoint::CheckpointError;

use super::{ImageKey, Prompt, Proposal, ProposalGenerator, SegmentError};
use mask_pixels::thresholded;

/// Points per side of the grid of the automatic masks unless another number is asked for, as in the original.
pub const POINTS_PER_SIDE: usize = 32;

/// Proposals by Segment Anything; depth only says where to ask for none.
pub struct SamProposals {
    network: Sam,
    device: Device,
    points_per_side: usize,
    /// Name of the network and checksum of its weights.
    weights: String,
}

impl SamProposals {
    /// The network in a file; notices go to the log.
    pub fn load(path: &Path, device: &Device) -> Result<Self, CheckpointError> {
        let checkpoint = SamCheckpoint::open(path)?;
        checkpoint.log_notices();
        Self::new(checkpoint, device)
    }

    /// The network in a checkpoint that has been read.
    pub fn new(checkpoint: SamCheckpoint, device: &Device) -> Result<Self, CheckpointError> {
        let name = checkpoint.sizes.published().unwrap_or("SAM").to_lowercase().replace(' ', "-");
        let weights = format!("{name}-{:08x}", checkpoint.checksum());
        let network = checkpoint.into_network(device)?;
        Ok(Self { network, device: device.clone(), points_per_side: POINTS_PER_SIDE, weights })
    }

    /// With a grid of `count x count` points, at least one.
    pub fn with_points_per_side(self, count: usize) -> Self {
        Self { points_per_side: count.max(1), ..self }
    }
}

impl ProposalGenerator for SamProposals {
    fn name(&self) -> String {
        format!("{}-{}", self.weights, self.points_per_side)
    }

    /// The number counts the versions of what is proposed.
    fn fingerprint(&self) -> String {
        format!("{} 2", self.name())
    }

    fn proposals(&self, frame: &RgbdFrame, _: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        automatic::proposals(&self.network, frame, self.points_per_side, &self.device)
    }

    /// The best of three masks for a point; the one mask for a box, which is not ambiguous.
    fn segment_prompt(&self, frame: &RgbdFrame, prompt: Prompt) -> Result<Proposal, SegmentError> {
        prompt.check(frame.width(), frame.height())?;
        let resize = ResizeLongestSide::new(frame.width(), frame.height(), self.network.image_size() as u32);
        let image = self.network.encode(resize.tensor(&frame.rgb, &self.device));
        let encoder = &self.network.prompt_encoder;
        let at = |col: u32, row: u32| resize.point([f64::from(col), f64::from(row)]);
        let prompts = match prompt {
            Prompt::Point(col, row) => encoder.embed_points(&[at(col, row)]),
            Prompt::Box(b) => encoder.embed_box([at(b.col_min, b.row_min), at(b.col_max, b.row_max)]),
        };
        let decoded = self.network.decode(&image, prompts);
        let overlaps = automatic::numbers(decoded.iou.clone())?;
        let masks = match prompt {
            Prompt::Point(..) => 1..overlaps.len(),
            Prompt::Box(_) => 0..1,
        };
        let best = masks.max_by(|&a, &b| overlaps[a].total_cmp(&overlaps[b])).unwrap_or(0);
        let logits = self.network.masks(&image, &decoded, 0, best..best + 1);
        let low = logits.dims()[2];
        let logits = Upscaling::new(low, &resize).apply(&automatic::numbers(logits)?);
        let score = overlaps.get(best).map_or(0.0, |iou| iou.clamp(0.0, 1.0));
        let found = Proposal::new(thresholded(&logits, resize.image), score);
        found.ok_or_else(|| prompt.refused("on an object: the mask that the network finds is empty".into()))
    }
}
