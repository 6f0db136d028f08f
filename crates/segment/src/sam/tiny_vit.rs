//! TinyViT, the image encoder of MobileSAM (Wu et al. 2022, Zhang et al. 2023): inverted bottlenecks, then stages of
//! windowed attention with a bias by absolute offset and a depthwise convolution in each block. Field names are the
//! published ones. Unlike the classifier of the same name, the last stage keeps the resolution.

use burn::{
    module::{Module, Param},
    nn::{Gelu, LayerNorm, LayerNormConfig, Linear},
    tensor::{Device, Int, Tensor, TensorData, module::linear as linear_map},
};
use unopose_nn::model::fused::{PositionBias, gelu, linear_gelu, linear_onto, positioned_self_attention};

use super::{
    conv_bn::ConvBn,
    grid::{from_windows, image_of, tokens_of, windows_of},
    layers::{Neck, convolution, linear, neck, parameter, through_neck},
    sizes::{AttentionStageSizes, StageSizes, TinyVitSizes},
};

/// Added to the variance, as published.
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// The whole encoder.
#[derive(Module, Debug)]
pub struct TinyVit {
    pub patch_embed: PatchEmbed,
    pub layers: Vec<Stage>,
    pub neck: Neck,
}

/// Two convolutions of stride 2.
#[derive(Module, Debug)]
pub struct PatchEmbed {
    pub seq: (ConvBn, Gelu, ConvBn),
}

/// A stage; the last one has no merging after it.
#[derive(Module, Debug)]
pub enum Stage {
    Convolutions(ConvolutionStage),
    Attentions(AttentionStage),
}

/// The first stage: inverted bottlenecks, then merging.
#[derive(Module, Debug)]
pub struct ConvolutionStage {
    pub blocks: Vec<InvertedBottleneck>,
    pub downsample: PatchMerging,
}

/// A later stage: blocks of windowed attention, then merging except after the last.
/// Norm, then self-attention within a window with a bias per offset.
#[derive(Module, Debug)]
pub struct AttentionStage {
    pub blocks: Vec<Block>,
    pub downsample: Option<PatchMerging>,
}

/// MBConv: wider, depthwise, narrower.
#[derive(Module, Debug)]
pub struct InvertedBottleneck {
    pub conv1: ConvBn,
    pub conv2: ConvBn,
    pub conv3: ConvBn,
}

/// To the channels of the next stage, at half the resolution or the same.
#[derive(Module, Debug)]
pub struct PatchMerging {
    pub conv1: ConvBn,
    pub conv2: ConvBn,
    pub conv3: ConvBn,
}

/// Windowed attention, depthwise convolution and perceptron.
#[derive(Module, Debug)]
pub struct Block {
    pub attn: Attention,
    pub local_conv: ConvBn,
    pub mlp: Mlp,
    window: usize,
}

#[derive(Module, Debug)]
pub struct Attention {
    pub norm: LayerNorm,
    /// Query, key and value of the first head, then those of the second, ...
    pub qkv: Linear,
    pub proj: Linear,
    /// Bias of each absolute offset in rows and columns, `[H, window^2]`.
    pub attention_biases: Param<Tensor<2>>,
}

/// Norm, then two linear layers.
#[derive(Module, Debug)]
pub struct Mlp {
    pub norm: LayerNorm,
    pub fc1: Linear,
    pub fc2: Linear,
}

impl TinyVit {
    /// `out` channels of the image embedding.
    pub(super) fn new(sizes: &TinyVitSizes, out: usize, device: &Device) -> Self {
        let first = sizes.convolutions;
        let second = sizes.attentions.first().map_or(first.width, |a| a.stage.width);
        let mut layers = vec![Stage::Convolutions(ConvolutionStage {
            blocks: (0..first.depth).map(|_| InvertedBottleneck::new(first, device)).collect(),
            downsample: PatchMerging::new(first.width, second, stride_before(1, sizes), device),
        })];
        for (index, stage) in sizes.attentions.iter().enumerate() {
            let next = sizes.attentions.get(index + 1).map(|next| {
                let stride = stride_before(index + 2, sizes);
                PatchMerging::new(stage.stage.width, next.stage.width, stride, device)
            });
            let blocks = (0..stage.stage.depth).map(|_| Block::new(stage, device)).collect();
            layers.push(Stage::Attentions(AttentionStage { blocks, downsample: next }));
        }
        let half = |channels| ConvBn::new(convolution(channels, 3, 2), device);
        let last = sizes.attentions.last().map_or(first.width, |a| a.stage.width);
        Self {
            patch_embed: PatchEmbed {
                seq: (half([3, sizes.stem]), Gelu::new(), half([sizes.stem, first.width])),
            },
            layers,
            neck: neck(last, out, device),
        }
    }

    /// Normalised padded image `[1, 3, S, S]` to its embedding `[1, (S / 16)^2, D]`.
    pub fn forward(&self, image: Tensor<4>) -> Tensor<3> {
        let x = self.layers.iter().fold(self.patches(image), |x, stage| stage.forward(x));
        let [.., h, w] = x.dims();
        through_neck(&self.neck, tokens_of(x), [h, w])
    }

    /// The image at a quarter of its resolution, `[1, C, S / 4, S / 4]`.
    pub fn patches(&self, image: Tensor<4>) -> Tensor<4> {
        let (first, _, second) = &self.patch_embed.seq;
        second.forward(gelu(first.forward(image)))
    }
}

/// Stride of the merging before a stage: the last one keeps the resolution.
fn stride_before(stage: usize, sizes: &TinyVitSizes) -> usize {
    if stage == sizes.attentions.len() { 1 } else { 2 }
}

impl Stage {
    /// `[1, C, h, w]` to `[1, C', h', w']`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        match self {
            Self::Convolutions(stage) => {
                let x = stage.blocks.iter().fold(x, |x, block| block.forward(x));
                stage.downsample.forward(x)
            }
            Self::Attentions(stage) => {
                let x = stage.blocks.iter().fold(x, |x, block| block.forward(x));
                match &stage.downsample {
                    Some(merging) => merging.forward(x),
                    None => x,
                }
            }
        }
    }
}

fn pointwise(input: usize, output: usize, device: &Device) -> ConvBn {
    ConvBn::new(convolution([input, output], 1, 1), device)
}

/// 3 x 3 for each channel alone.
fn depthwise(channels: usize, stride: usize, device: &Device) -> ConvBn {
    ConvBn::new(convolution([channels, channels], 3, stride).with_groups(channels), device)
}

impl InvertedBottleneck {
    fn new(stage: StageSizes, device: &Device) -> Self {
        Self {
            conv1: pointwise(stage.width, stage.hidden, device),
            conv2: depthwise(stage.hidden, 1, device),
            conv3: pointwise(stage.hidden, stage.width, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let hidden = gelu(self.conv1.forward(x.clone()));
        let hidden = gelu(self.conv2.forward(hidden));
        gelu(self.conv3.forward(hidden) + x)
    }
}

impl PatchMerging {
    fn new(input: usize, output: usize, stride: usize, device: &Device) -> Self {
        Self {
            conv1: pointwise(input, output, device),
            conv2: depthwise(output, stride, device),
            conv3: pointwise(output, output, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = gelu(self.conv1.forward(x));
        self.conv3.forward(gelu(self.conv2.forward(x)))
    }
}

impl Block {
    fn new(sizes: &AttentionStageSizes, device: &Device) -> Self {
        let (width, hidden) = (sizes.stage.width, sizes.stage.hidden);
        let norm = || LayerNormConfig::new(width).with_epsilon(LAYER_NORM_EPSILON).init(device);
        Self {
            attn: Attention {
                norm: norm(),
                qkv: linear(width, 3 * width, device),
                proj: linear(width, width, device),
                attention_biases: parameter([sizes.heads, sizes.window * sizes.window], device),
            },
            local_conv: depthwise(width, 1, device),
            mlp: Mlp { norm: norm(), fc1: linear(width, hidden, device), fc2: linear(hidden, width, device) },
            window: sizes.window,
        }
    }

    /// `[1, C, h, w]`.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [.., h, w] = x.dims();
        let grid = [h, w];
        let tokens = tokens_of(x);
        // Padding comes before the norm.
        let windows = self.attn.forward(windows_of(tokens.clone(), grid, self.window), self.window);
        let x = tokens + from_windows(windows, grid, self.window);
        let x = tokens_of(self.local_conv.forward(image_of(x, grid)));
        let hidden = linear_gelu(self.mlp.norm.forward(x.clone()), &self.mlp.fc1);
        let ones = Tensor::ones([x.dims()[2]], &x.device());
        image_of(linear_onto(x, hidden, &self.mlp.fc2, ones), grid)
    }
}

impl Attention {
    /// Windows `[B, side^2, C]`.
    fn forward(&self, x: Tensor<3>, side: usize) -> Tensor<3> {
        let x = self.norm.forward(x);
        let [heads, _] = self.attention_biases.dims();
        let (weight, bias) = self.joint_projection(heads);
        let table = self.bias_table(side);
        let qkv = linear_map(x, weight, bias);
        self.proj.forward(positioned_self_attention(qkv, heads, PositionBias::Table(&table)))
    }

    /// The joint projection with all queries first, then all keys, then all values: `[C, 3 C]` and `[3 C]`.
    fn joint_projection(&self, heads: usize) -> (Tensor<2>, Option<Tensor<1>>) {
        let [input, joint] = self.qkv.weight.dims();
        let d = joint / 3 / heads;
        let weight: Tensor<4> = self.qkv.weight.val().reshape([input, heads, 3, d]);
        let bias = self.qkv.bias.as_ref().map(|bias| {
            let bias: Tensor<3> = bias.val().reshape([heads, 3, d]);
            bias.swap_dims(0, 1).reshape([joint])
        });
        (weight.swap_dims(1, 2).reshape([input, joint]), bias)
    }

    /// Biases of all pairs of tokens, `[H, side^2, side^2]`.
    fn bias_table(&self, side: usize) -> Tensor<3> {
        let tokens = side * side;
        let offset =
            |a: usize, b: usize| (a / side).abs_diff(b / side) * side + (a % side).abs_diff(b % side);
        let index = (0..tokens).flat_map(|a| (0..tokens).map(move |b| offset(a, b) as i32));
        let index = TensorData::new(index.collect::<Vec<_>>(), [tokens * tokens]);
        let biases = self.attention_biases.val();
        let index = Tensor::<1, Int>::from_data(index, &biases.device());
        let heads = biases.dims()[0];
        biases.select(1, index).reshape([heads, tokens, tokens])
    }
}
