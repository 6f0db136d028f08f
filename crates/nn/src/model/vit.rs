//! Vision transformer in the DINOv2 form (LayerScale, register tokens, GELU). Field names are timm's.

use burn::{
    module::{Module, Param},
    nn::{
        LayerNorm, Linear,
        conv::{Conv2d, Conv2dConfig},
    },
    tensor::{Int, Tensor, TensorData},
};
use unopose_core::config::VitConfig;

use super::{
    fused::{VisionMaps, linear_gelu, linear_onto, self_attention, vision_block, vision_block_at},
    init::Initializer,
    rows::select_rows,
};

pub(super) const LAYER_NORM_EPSILON: f64 = 1e-6;
/// Blocks whose tokens are read.
const LEVELS: usize = 4;

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
    /// Class token `[1, 1, C]`.
    pub cls_token: Param<Tensor<3>>,
    /// Register tokens `[1, R, C]`.
    pub reg_token: Option<Param<Tensor<3>>>,
    /// `[1, patches (+ 1 for the class token unless no_embed_class), embed_dim]`.
    pub pos_embed: Param<Tensor<3>>,
    /// Patches to tokens.
    pub patch_embed: PatchEmbed,
    /// Pre-norm attention and perceptron.
    pub blocks: Vec<VitBlock>,
    /// Norm of the last tokens.
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
    /// Initial weights for square images of `image_size` pixels.
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

    /// Channels of a token.
    pub fn channels(&self) -> usize {
        self.cls_token.dims()[2]
    }

    /// Normalised images `[B, 3, S, S]`, `S` a multiple of the patch size.
    pub fn forward(&self, images: Tensor<4>) -> VitFeatures {
        let (mut x, patches) = self.embed(images);
        let [batch, tokens, channels] = x.dims();
        let mut pyramid = Vec::with_capacity(LEVELS);
        let mut class_token = None;
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            let hits = self.levels_at(index);
            if hits == 0 {
                continue;
            }
            let normed = self.norm.forward(x.clone());
            class_token = Some(normed.clone().slice([0..batch, 0..1]).reshape([batch, channels]));
            let of_patches = normed.slice([0..batch, tokens - patches..tokens]);
            pyramid.extend(std::iter::repeat_n(of_patches, hits));
        }
        VitFeatures {
            pyramid: Tensor::cat(pyramid, 2),
            class_token: class_token.unwrap_or_else(|| self.cls_token.val().reshape([1, channels])),
        }
    }

    /// Patch tokens after the first `blocks` blocks and the final norm, row-major: `[B, patches, embed_dim]`. Those of half to
    /// three quarters of the depth tell the places of an object apart better than those of the last block.
    pub fn tokens_after(&self, images: Tensor<4>, blocks: usize) -> Tensor<3> {
        let (x, patches) = self.embed(images);
        let x = self.blocks.iter().take(blocks).fold(x, |x, block| block.forward(x));
        let [batch, tokens, channels] = x.dims();
        self.norm.forward(x.slice([0..batch, tokens - patches..tokens, 0..channels]))
    }

    /// Number of blocks.
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// Rows of `VitFeatures::pyramid`, as a list `[B * patches]`, for some patches, image by image: `[n, 4 * embed_dim]`.
    /// The last block is computed for these only.
    pub fn forward_at(&self, images: Tensor<4>, wanted: &[usize]) -> Tensor<2> {
        let (mut x, patches) = self.embed(images);
        let [batch, tokens, channels] = x.dims();
        let row = |&patch: &usize| patch / patches * tokens + tokens - patches + patch % patches;
        let wanted: Vec<usize> = wanted.iter().map(row).collect();
        let rows: Vec<i32> = wanted.iter().map(|&row| row as i32).collect();
        let rows = Tensor::<1, Int>::from_data(TensorData::new(rows, [wanted.len()]), &x.device().inner());
        let mut pyramid = Vec::with_capacity(LEVELS);
        for (index, block) in self.blocks.iter().enumerate() {
            let hits = self.levels_at(index);
            let chosen = if index + 1 == self.blocks.len() {
                block.forward_at(x.clone(), &wanted, &rows)
            } else {
                x = block.forward(x);
                if hits == 0 {
                    continue;
                }
                select_rows(x.clone().reshape([batch * tokens, channels]), rows.clone())
            };
            pyramid.extend(std::iter::repeat_n(self.norm.forward(chosen), hits));
        }
        Tensor::cat(pyramid, 1)
    }

    /// How many of the four levels block `index` gives.
    fn levels_at(&self, index: usize) -> usize {
        let depth = self.blocks.len();
        (0..LEVELS).filter(|level| (depth - 1).saturating_sub(level * (depth / LEVELS)) == index).count()
    }

    /// Class token, registers and patches `[B, T, C]`, and the number of patches, which come last.
    fn embed(&self, images: Tensor<4>) -> (Tensor<3>, usize) {
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
        let Some(registers) = &self.reg_token else { return (x, patches) };
        let registers = registers.val();
        let count = registers.dims()[1];
        let [_, tokens, _] = x.dims();
        let parts = vec![
            x.clone().slice([0..batch, 0..1]),
            registers.expand([batch, count, channels]),
            x.slice([0..batch, 1..tokens]),
        ];
        (Tensor::cat(parts, 1), patches)
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
    pub(super) fn new(width: usize, heads: usize, init: &mut Initializer) -> Self {
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

    pub(super) fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        if let Some(y) = vision_block(&self.maps(), &x) {
            return y;
        }
        let attended = self.attn.heads(self.norm1.forward(x.clone()));
        let x = linear_onto(x, attended, &self.attn.proj, self.ls1.gamma.val());
        let hidden = linear_gelu(self.norm2.forward(x.clone()), &self.mlp.fc1);
        linear_onto(x, hidden, &self.mlp.fc2, self.ls2.gamma.val())
    }

    /// Tokens `wanted` of the list `[B * T]`, image by image, after the block: `[n, C]`; `rows` are the same on the device.
    fn forward_at(&self, x: Tensor<3>, wanted: &[usize], rows: &Tensor<1, Int>) -> Tensor<2> {
        if let Some(y) = vision_block_at(&self.maps(), &x, wanted) {
            return y;
        }
        let [batch, tokens, channels] = x.dims();
        select_rows(self.forward(x).reshape([batch * tokens, channels]), rows.clone())
    }

    fn maps(&self) -> VisionMaps<'_> {
        VisionMaps {
            norm1: &self.norm1,
            qkv: &self.attn.qkv,
            proj: &self.attn.proj,
            norm2: &self.norm2,
            fc1: &self.mlp.fc1,
            fc2: &self.mlp.fc2,
            scales: [self.ls1.gamma.val(), self.ls2.gamma.val()],
            heads: self.attn.heads,
            epsilon: LAYER_NORM_EPSILON,
        }
    }
}

impl SelfAttention {
    /// What the heads read, before the output projection.
    fn heads(&self, x: Tensor<3>) -> Tensor<3> {
        self_attention(self.qkv.forward(x), self.heads)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Distribution};

    use super::*;

    #[test]
    fn fused_block_equals_its_plain_form() {
        let device = Device::default();
        let init = &mut Initializer::new(5, &device);
        let mut block = VitBlock::new(128, 2, init);
        block.ls1.gamma = init.normal([128], 1.0);
        block.ls2.gamma = init.normal([128], 1.0);
        let x = Tensor::<3>::random([2, 37, 128], Distribution::Uniform(-1.0, 1.0), &device);
        assert!(vision_block(&block.maps(), &x).is_some() || cfg!(not(feature = "flex")));
        // On the tape the plain form runs.
        let plain = block.forward(x.clone().autodiff()).inner();
        let largest = |difference: Tensor<3>| difference.abs().max().into_scalar::<f32>();
        let whole = largest(block.forward(x.clone()) - plain.clone());
        assert!(whole < 1e-5, "{whole}");
        // Tokens of both images, in no order within each.
        let wanted = [36, 2, 5, 40, 37, 73];
        let rows = Tensor::<1, Int>::from_data(wanted.map(|row| row as i32), &device);
        let some = block.forward_at(x, &wanted, &rows) - plain.reshape([74, 128]).select(0, rows);
        let some = largest(some.unsqueeze());
        assert!(some < 1e-5, "{some}");
    }

    #[test]
    fn chosen_patches_are_rows_of_the_pyramid() {
        let device = Device::default();
        let config = VitConfig { embed_dim: 128, depth: 5, heads: 2, patch_size: 8, ..VitConfig::default() };
        let vit = VisionTransformer::new(&config, 32, &mut Initializer::new(7, &device));
        let images = Tensor::<4>::random([2, 3, 32, 32], Distribution::Uniform(-1.0, 1.0), &device);
        let wanted = [3, 0, 15, 16, 31];
        let rows = Tensor::<1, Int>::from_data(wanted.map(|row| row as i32), &device);
        let whole = vit.forward(images.clone()).pyramid;
        // The levels of five blocks are the outputs of blocks 2 to 5.
        for (level, blocks) in (2..=5).enumerate() {
            let own = vit.tokens_after(images.clone(), blocks) - whole.clone().narrow(2, 128 * level, 128);
            assert!(own.abs().max().into_scalar::<f32>() < 1e-5, "{blocks} blocks");
        }
        let pyramid = whole.reshape([32, 512]).select(0, rows);
        for got in
            [vit.forward_at(images.clone(), &wanted), vit.forward_at(images.autodiff(), &wanted).inner()]
        {
            let largest = (got - pyramid.clone()).abs().max().into_scalar::<f32>();
            assert!(largest < 1e-5, "{largest}");
        }
    }
}
