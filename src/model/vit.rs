//! Vision transformer in the DINOv2 form (LayerScale, register tokens, GELU). Field names are timm's.

use burn::{
    module::{Module, Param},
    nn::{
        LayerNorm, Linear,
        conv::{Conv2d, Conv2dConfig},
    },
    tensor::Tensor,
};

use super::{
    fused::{linear_gelu, linear_onto, self_attention},
    init::Initializer,
};
use crate::config::VitConfig;

const LAYER_NORM_EPSILON: f64 = 1e-6;

/// Patch projection.
#[derive(Module, Debug)]
pub struct PatchEmbed {
    pub proj: Conv2d,
}

/// Multi-head self attention.
#[derive(Module, Debug)]
pub struct SelfAttention {
    pub qkv: Linear,
    pub proj: Linear,
    heads: usize,
}

/// Two-layer perceptron with GELU.
#[derive(Module, Debug)]
pub struct Mlp {
    pub fc1: Linear,
    pub fc2: Linear,
}

/// Learned scale per channel.
#[derive(Module, Debug)]
pub struct LayerScale {
    pub gamma: Param<Tensor<1>>,
}

/// Pre-norm transformer block.
#[derive(Module, Debug)]
pub struct VitBlock {
    pub norm1: LayerNorm,
    pub attn: SelfAttention,
    pub ls1: LayerScale,
    pub norm2: LayerNorm,
    pub mlp: Mlp,
    pub ls2: LayerScale,
}

/// The transformer without a classification head.
#[derive(Module, Debug)]
pub struct VisionTransformer {
    pub cls_token: Param<Tensor<3>>,
    pub reg_token: Option<Param<Tensor<3>>>,
    /// `[1, patches (+ 1 for the class token unless no_embed_class), embed_dim]`.
    pub pos_embed: Param<Tensor<3>>,
    pub patch_embed: PatchEmbed,
    pub blocks: Vec<VitBlock>,
    pub norm: LayerNorm,
    patch_size: usize,
    no_embed_class: bool,
}

/// Outputs of [`VisionTransformer::forward`].
pub struct VitFeatures {
    /// Final-norm patch tokens of four blocks, the last one's last, concatenated over channels:
    /// `[B, patches, 4 * embed_dim]`.
    pub pyramid: Tensor<3>,
    /// Class token after the last block and norm: `[B, embed_dim]`.
    pub class_token: Tensor<2>,
}

impl VitFeatures {
    /// Patch tokens after the last block and norm, row-major: `[B, patches, embed_dim]`.
    pub fn patch_tokens(&self) -> Tensor<3> {
        let [batch, patches, channels] = self.pyramid.dims();
        let last = channels - self.class_token.dims()[1];
        self.pyramid.clone().slice([0..batch, 0..patches, last..channels])
    }
}

impl VisionTransformer {
    pub fn new(config: &VitConfig, image_size: usize, init: &mut Initializer) -> Self {
        let width = config.embed_dim;
        let side = image_size / config.patch_size;
        let tokens = side * side + usize::from(!config.no_embed_class);
        let device = init.device();
        Self {
            cls_token: init.normal([1, 1, width], 1e-6),
            reg_token: (config.register_tokens > 0)
                .then(|| init.normal([1, config.register_tokens, width], 1e-6)),
            pos_embed: init.normal([1, tokens, width], 0.02),
            patch_embed: PatchEmbed { proj: patch_projection(config.patch_size, width, init) },
            blocks: (0..config.depth).map(|_| VitBlock::new(width, config.heads, init)).collect(),
            norm: burn::nn::LayerNormConfig::new(width).with_epsilon(LAYER_NORM_EPSILON).init(device),
            patch_size: config.patch_size,
            no_embed_class: config.no_embed_class,
        }
    }

    /// Side of a patch, pixels.
    pub fn patch_size(&self) -> usize {
        self.patch_size
    }

    /// Normalised images `[B, 3, S, S]`, `S` a multiple of the patch size.
    pub fn forward(&self, images: Tensor<4>) -> VitFeatures {
        let [batch, _, height, width] = images.dims();
        let patches = (height / self.patch_size) * (width / self.patch_size);
        let x = self.patch_embed.proj.forward(images); // [B, C, h, w]
        let channels = x.dims()[1];
        let x = x.reshape([batch, channels, patches]).swap_dims(1, 2); // [B, patches, C]
        let class = self.cls_token.val().expand([batch, 1, channels]);
        let x = if self.no_embed_class {
            Tensor::cat(vec![class, x + self.pos_embed.val()], 1)
        } else {
            Tensor::cat(vec![class, x], 1) + self.pos_embed.val()
        };
        let (mut x, prefix) = match &self.reg_token {
            None => (x, 1),
            Some(registers) => {
                let registers = registers.val();
                let count = registers.dims()[1];
                let [_, tokens, _] = x.dims();
                let parts = vec![
                    x.clone().slice([0..batch, 0..1]),
                    registers.expand([batch, count, channels]),
                    x.slice([0..batch, 1..tokens]),
                ];
                (Tensor::cat(parts, 1), 1 + count)
            }
        };
        let depth = self.blocks.len();
        let level = |k: usize| (depth - 1).saturating_sub(k * (depth / 4));
        let levels = [level(3), level(2), level(1), level(0)];
        let mut pyramid = Vec::with_capacity(4);
        let mut class_token = None;
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            let hits = levels.iter().filter(|&&l| l == index).count();
            if hits == 0 {
                continue;
            }
            let normed = self.norm.forward(x.clone());
            class_token = Some(normed.clone().slice([0..batch, 0..1]).reshape([batch, channels]));
            let tokens = normed.slice([0..batch, prefix..prefix + patches]);
            pyramid.extend(std::iter::repeat_n(tokens, hits));
        }
        VitFeatures {
            pyramid: Tensor::cat(pyramid, 2),
            class_token: class_token.unwrap_or_else(|| self.cls_token.val().reshape([1, channels])),
        }
    }
}

fn patch_projection(patch: usize, width: usize, init: &mut Initializer) -> Conv2d {
    let mut conv =
        Conv2dConfig::new([3, width], [patch, patch]).with_stride([patch, patch]).init(init.device());
    let bound = 1.0 / ((3 * patch * patch) as f64).sqrt();
    conv.weight = init.uniform([width, 3, patch, patch], bound);
    conv.bias = Some(init.uniform([width], bound));
    conv
}

impl VitBlock {
    fn new(width: usize, heads: usize, init: &mut Initializer) -> Self {
        Self {
            norm1: init.layer_norm(width, LAYER_NORM_EPSILON),
            attn: SelfAttention {
                qkv: init.linear(width, 3 * width),
                proj: init.linear(width, width),
                heads,
            },
            ls1: LayerScale { gamma: init.constant([width], 1.0) },
            norm2: init.layer_norm(width, LAYER_NORM_EPSILON),
            mlp: Mlp { fc1: init.linear(width, 4 * width), fc2: init.linear(4 * width, width) },
            ls2: LayerScale { gamma: init.constant([width], 1.0) },
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let attended = self.attn.heads(self.norm1.forward(x.clone()));
        let x = linear_onto(x, attended, &self.attn.proj, self.ls1.gamma.val());
        let hidden = linear_gelu(self.norm2.forward(x.clone()), &self.mlp.fc1);
        linear_onto(x, hidden, &self.mlp.fc2, self.ls2.gamma.val())
    }
}

impl SelfAttention {
    /// What the heads read, before the output projection.
    fn heads(&self, x: Tensor<3>) -> Tensor<3> {
        self_attention(self.qkv.forward(x), self.heads)
    }
}
