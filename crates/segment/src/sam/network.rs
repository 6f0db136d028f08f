//! The whole network. Field names are the published ones.

use std::ops::Range;

use burn::{
    module::Module,
    tensor::{Device, Tensor},
};

use super::{
    image_encoder::ImageEncoderVit,
    mask_decoder::{Decoded, MaskDecoder},
    prompt_encoder::PromptEncoder,
    sizes::{EncoderSizes, SamSizes},
    tiny_vit::TinyVit,
};

/// Segment Anything (Kirillov et al. 2023), with its own image encoder or MobileSAM's.
#[derive(Module, Debug)]
pub struct Sam {
    /// Image to embedding.
    pub image_encoder: ImageEncoder,
    /// Points and boxes to tokens.
    pub prompt_encoder: PromptEncoder,
    /// Embedding and tokens to masks.
    pub(super) mask_decoder: MaskDecoder,
    image_size: usize,
}

/// One of the two image encoders.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // There is one of it in a network.
pub enum ImageEncoder {
    /// That of SAM ViT-B, L and H.
    Vit(ImageEncoderVit),
    /// That of MobileSAM.
    TinyVit(TinyVit),
}

/// An image as the decoder needs it.
#[derive(Clone, Debug)]
pub struct ImageEmbedding {
    /// One token per patch, row by row, `[1, T, D]`.
    pub tokens: Tensor<3>,
    /// Positions of the tokens, the same for all prompts, `[1, T, D]`.
    positions: Tensor<3>,
    /// Rows and columns of tokens.
    pub grid: [usize; 2],
}

impl Sam {
    /// A network without values.
    pub(super) fn new(sizes: &SamSizes, device: &Device) -> Self {
        let width = sizes.decoder.width;
        Self {
            image_encoder: match &sizes.encoder {
                EncoderSizes::Vit(vit) => {
                    ImageEncoder::Vit(ImageEncoderVit::new(vit, sizes.image_size, width, device))
                }
                EncoderSizes::TinyVit(tiny) => ImageEncoder::TinyVit(TinyVit::new(tiny, width, device)),
            },
            prompt_encoder: PromptEncoder::new(width, sizes.image_size, device),
            mask_decoder: MaskDecoder::new(&sizes.decoder, device),
            image_size: sizes.image_size,
        }
    }

    /// Side of the padded input, pixels.
    pub fn image_size(&self) -> usize {
        self.image_size
    }

    /// Normalised padded image `[1, 3, S, S]` to its embedding.
    pub fn encode(&self, image: Tensor<4>) -> ImageEmbedding {
        let tokens = match &self.image_encoder {
            ImageEncoder::Vit(encoder) => encoder.forward(image),
            ImageEncoder::TinyVit(encoder) => encoder.forward(image),
        };
        let side = tokens.dims()[1].isqrt();
        let grid = [side, side];
        ImageEmbedding { tokens, positions: self.prompt_encoder.positions(grid), grid }
    }

    /// Decodes the tokens of P prompts, `[P, N, D]`, as [`Self::prompt_encoder`] makes them.
    pub fn decode(&self, image: &ImageEmbedding, prompts: Tensor<3>) -> Decoded {
        let tokens = image.tokens.clone() + self.prompt_encoder.no_mask();
        self.mask_decoder.forward(tokens, image.positions.clone(), prompts)
    }

    /// Logits of some masks of a prompt, `[masks, S / 4, S / 4]` for patches of 16 pixels.
    pub fn masks(
        &self,
        image: &ImageEmbedding,
        decoded: &Decoded,
        prompt: usize,
        masks: Range<usize>,
    ) -> Tensor<3> {
        self.mask_decoder.masks(decoded, prompt, masks, image.grid)
    }
}
