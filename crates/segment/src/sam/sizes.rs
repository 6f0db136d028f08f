//! Sizes of a Segment Anything network, read off the shapes of its tensors.

use std::{collections::BTreeMap, fmt};

/// Names and shapes of a file's tensors.
pub(super) type Shapes = BTreeMap<String, Vec<usize>>;

/// Sizes of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SamSizes {
    pub(super) encoder: EncoderSizes,
    /// Side of the square image that the encoder sees, pixels.
    pub image_size: usize,
    pub(super) decoder: DecoderSizes,
}

/// The image encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum EncoderSizes {
    /// ViT-B, L or H, or one like them.
    Vit(VitSizes),
    /// MobileSAM's.
    TinyVit(TinyVitSizes),
}

/// A vision transformer with windowed attention.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct VitSizes {
    /// Side of a patch, pixels.
    pub patch_size: usize,
    /// Channels of a token.
    pub width: usize,
    pub heads: usize,
    /// Hidden channels of the blocks' perceptrons.
    pub mlp_width: usize,
    /// Side of each block's windows, patches; `None` where all patches attend to each other.
    pub windows: Vec<Option<usize>>,
}

/// A TinyViT.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TinyVitSizes {
    /// Channels after the first convolution, at half resolution.
    pub stem: usize,
    /// The first stage: inverted bottlenecks.
    pub convolutions: StageSizes,
    /// The stages of windowed attention.
    pub attentions: Vec<AttentionStageSizes>,
}

/// A stage of TinyViT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StageSizes {
    /// Channels.
    pub width: usize,
    /// Blocks.
    pub depth: usize,
    /// Hidden channels of each block.
    pub hidden: usize,
}

/// A stage of TinyViT with attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AttentionStageSizes {
    pub stage: StageSizes,
    pub heads: usize,
    /// Side of the windows, tokens.
    pub window: usize,
}

/// Prompt encoder and mask decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DecoderSizes {
    /// Channels of image embedding, prompts and masks.
    pub width: usize,
    /// Blocks of the two-way transformer.
    pub depth: usize,
    /// Hidden channels of their perceptrons.
    pub mlp_width: usize,
    /// Channels of the attention between tokens and image.
    pub attention_width: usize,
    /// Hidden channels of the head that predicts the overlap.
    pub iou_width: usize,
    /// Mask tokens: one for a single mask and the others for three nested ones.
    pub mask_tokens: usize,
}

/// Why the shapes of a file are not those of a network.
#[derive(Debug)]
pub(super) enum SizeError {
    /// The names are those of no known image encoder.
    Encoder,
    /// A tensor is missing.
    Missing(String),
    /// A tensor has a shape that no network has.
    Shape { name: String, shape: Vec<usize>, expected: &'static str },
}

/// Attention heads of the decoder: every published network has as many, and no shape tells.
pub(super) const HEADS: usize = 8;

/// MobileSAM's files do not say for which image size they are.
const MOBILE_SAM_IMAGE: usize = 1024;

impl SamSizes {
    /// Reads the sizes off the shapes of all tensors.
    pub(super) fn of(shapes: &Shapes) -> Result<Self, SizeError> {
        let has = |name: &str| shapes.contains_key(name);
        let tiny = has("image_encoder.patch_embed.seq.0.c.weight");
        if !tiny && !has("image_encoder.pos_embed") && !has("image_encoder.patch_embed.proj.weight") {
            return Err(SizeError::Encoder);
        }
        let shapes = Reader(shapes);
        let (encoder, image_size) = match tiny {
            true => (EncoderSizes::TinyVit(tiny_vit(&shapes)?), MOBILE_SAM_IMAGE),
            false => vit(&shapes).map(|(sizes, image_size)| (EncoderSizes::Vit(sizes), image_size))?,
        };
        Ok(Self { encoder, image_size, decoder: decoder(&shapes)? })
    }

    /// The name under which a network of these sizes is published.
    pub(super) fn published(&self) -> Option<&'static str> {
        match &self.encoder {
            EncoderSizes::Vit(vit) => match (vit.width, vit.windows.len()) {
                (768, 12) => Some("SAM ViT-B"),
                (1024, 24) => Some("SAM ViT-L"),
                (1280, 32) => Some("SAM ViT-H"),
                _ => None,
            },
            EncoderSizes::TinyVit(tiny) => {
                let widths: Vec<usize> = tiny.attentions.iter().map(|a| a.stage.width).collect();
                (tiny.convolutions.width == 64 && widths == [128, 160, 320]).then_some("MobileSAM")
            }
        }
    }
}

fn vit(shapes: &Reader) -> Result<(VitSizes, usize), SizeError> {
    let at = |name: &str| format!("image_encoder.{name}");
    let patch_size = shapes.axis(&at("patch_embed.proj.weight"), 2, 4)?;
    let (side, width) = (shapes.axis(&at("pos_embed"), 1, 4)?, shapes.axis(&at("pos_embed"), 3, 4)?);
    let depth = shapes.count(&at("blocks."));
    if depth == 0 {
        return Err(SizeError::Missing(at("blocks.0.attn.rel_pos_h")));
    }
    let first = at("blocks.0.attn.rel_pos_h");
    let head_width = shapes.axis(&first, 1, 2)?;
    if !width.is_multiple_of(head_width) {
        return Err(shapes.refused(&first, "[2 w - 1, channels of a head], which divide those of pos_embed"));
    }
    let window = |block: usize| {
        let name = at(&format!("blocks.{block}.attn.rel_pos_h"));
        let offsets = shapes.axis(&name, 0, 2)?;
        if offsets.is_multiple_of(2) {
            return Err(shapes.refused(&name, "an odd number of rows, one for each offset in a window"));
        }
        let window = offsets.div_ceil(2);
        Ok((window != side).then_some(window))
    };
    let sizes = VitSizes {
        patch_size,
        width,
        heads: width / head_width,
        mlp_width: shapes.axis(&at("blocks.0.mlp.lin1.weight"), 0, 2)?,
        windows: (0..depth).map(window).collect::<Result<_, _>>()?,
    };
    Ok((sizes, side * patch_size))
}

fn tiny_vit(shapes: &Reader) -> Result<TinyVitSizes, SizeError> {
    let at = |name: &str| format!("image_encoder.{name}");
    let attention = |layer: usize| {
        let block = |name: &str| at(&format!("layers.{layer}.blocks.0.{name}"));
        let biases = block("attn.attention_biases");
        let (heads, offsets) = (shapes.axis(&biases, 0, 2)?, shapes.axis(&biases, 1, 2)?);
        let window = offsets.isqrt();
        let width = shapes.axis(&block("attn.proj.weight"), 0, 2)?;
        if window * window != offsets || !width.is_multiple_of(heads) {
            return Err(shapes.refused(&biases, "[heads, w^2] with heads that divide the channels"));
        }
        let hidden = shapes.axis(&block("mlp.fc1.weight"), 0, 2)?;
        let depth = shapes.count(&at(&format!("layers.{layer}.blocks.")));
        Ok(AttentionStageSizes { stage: StageSizes { width, depth, hidden }, heads, window })
    };
    let layers = shapes.count(&at("layers."));
    if layers < 2 {
        return Err(SizeError::Missing(at("layers.1.blocks.0.attn.attention_biases")));
    }
    Ok(TinyVitSizes {
        stem: shapes.axis(&at("patch_embed.seq.0.c.weight"), 0, 4)?,
        convolutions: StageSizes {
            width: shapes.axis(&at("patch_embed.seq.2.c.weight"), 0, 4)?,
            depth: shapes.count(&at("layers.0.blocks.")),
            hidden: shapes.axis(&at("layers.0.blocks.0.conv1.c.weight"), 0, 4)?,
        },
        attentions: (1..layers).map(attention).collect::<Result<_, _>>()?,
    })
}

fn decoder(shapes: &Reader) -> Result<DecoderSizes, SizeError> {
    let at = |name: &str| format!("mask_decoder.{name}");
    let layer = |name: &str| at(&format!("transformer.layers.0.{name}"));
    let tokens = at("mask_tokens.weight");
    let sizes = DecoderSizes {
        width: shapes.axis(&tokens, 1, 2)?,
        depth: shapes.count(&at("transformer.layers.")),
        mlp_width: shapes.axis(&layer("mlp.lin1.weight"), 0, 2)?,
        attention_width: shapes.axis(&layer("cross_attn_token_to_image.q_proj.weight"), 0, 2)?,
        iou_width: shapes.axis(&at("iou_prediction_head.layers.0.weight"), 0, 2)?,
        mask_tokens: shapes.axis(&tokens, 0, 2)?,
    };
    if !sizes.width.is_multiple_of(HEADS) || sizes.mask_tokens < 2 {
        return Err(shapes.refused(&tokens, "[2 or more, a multiple of the 8 heads]"));
    }
    if !sizes.attention_width.is_multiple_of(HEADS) {
        let name = layer("cross_attn_token_to_image.q_proj.weight");
        return Err(shapes.refused(&name, "a multiple of the 8 heads as first axis"));
    }
    Ok(sizes)
}

/// Looks up shapes by name.
struct Reader<'a>(&'a Shapes);

impl Reader<'_> {
    /// Length of an axis of a tensor of `rank` axes, none of which may be empty.
    fn axis(&self, name: &str, axis: usize, rank: usize) -> Result<usize, SizeError> {
        let shape = self.0.get(name).ok_or_else(|| SizeError::Missing(name.to_owned()))?;
        let expected = match rank {
            2 => "two axes, none empty",
            _ => "four axes, none empty",
        };
        match shape.get(axis) {
            Some(&length) if shape.len() == rank && !shape.contains(&0) => Ok(length),
            _ => Err(self.refused(name, expected)),
        }
    }

    fn refused(&self, name: &str, expected: &'static str) -> SizeError {
        let shape = self.0.get(name).cloned().unwrap_or_default();
        SizeError::Shape { name: name.to_owned(), shape, expected }
    }

    /// One more than the largest index after the prefix; no index reaches the number of tensors.
    fn count(&self, prefix: &str) -> usize {
        let index = |name: &String| name.strip_prefix(prefix)?.split('.').next()?.parse::<usize>().ok();
        self.0.keys().filter_map(index).filter(|&i| i < self.0.len()).max().map_or(0, |last| last + 1)
    }
}

impl fmt::Display for SamSizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.published().unwrap_or("a Segment Anything network of other sizes"))?;
        match &self.encoder {
            EncoderSizes::Vit(vit) => {
                let global = vit.windows.iter().enumerate().filter(|(_, window)| window.is_none());
                let global: Vec<String> = global.map(|(block, _)| block.to_string()).collect();
                writeln!(f, "image encoder: vision transformer, patches of {} pixels", vit.patch_size)?;
                writeln!(f, "width: {}, depth: {}, heads: {}", vit.width, vit.windows.len(), vit.heads)?;
                writeln!(f, "blocks without windows: {}", global.join(", "))?;
            }
            EncoderSizes::TinyVit(tiny) => {
                let stages = [tiny.convolutions].into_iter().chain(tiny.attentions.iter().map(|a| a.stage));
                let stages: Vec<String> = stages.map(|s| format!("{} x {}", s.depth, s.width)).collect();
                writeln!(
                    f,
                    "image encoder: TinyViT, blocks x channels of its stages: {}",
                    stages.join(", ")
                )?;
            }
        }
        writeln!(f, "image: {0} x {0} pixels", self.image_size)?;
        let decoder = &self.decoder;
        writeln!(
            f,
            "decoder: width {}, depth {}, {} mask tokens",
            decoder.width, decoder.depth, decoder.mask_tokens
        )
    }
}
