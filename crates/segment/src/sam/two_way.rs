//! The decoder's transformer: tokens attend to each other and to the image, and the image attends to the tokens. Field
//! names are the published ones.
//!
//! There are thousands of image tokens for a few others, so the few are projected instead of the many: a score
//! `(W_q t) . (W_k x)` is `(W_k^T W_q t) . x`, and a sum of values `sum_i a_i W_v x_i` is `W_v sum_i a_i x_i`.

use burn::{
    module::Module,
    nn::{LayerNorm, LayerNormConfig, Linear},
    tensor::{
        Device, Tensor,
        activation::{relu, softmax},
    },
};

use super::{
    layers::{MlpBlock, linear},
    sizes::{DecoderSizes, HEADS},
};

/// Added to the variance, as published.
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// The transformer.
#[derive(Module, Debug)]
pub struct TwoWayTransformer {
    pub layers: Vec<TwoWayAttentionBlock>,
    pub final_attn_token_to_image: Attention,
    pub norm_final_attn: LayerNorm,
}

/// Self-attention of the tokens, tokens to image, perceptron, image to tokens.
#[derive(Module, Debug)]
pub struct TwoWayAttentionBlock {
    pub self_attn: Attention,
    pub norm1: LayerNorm,
    pub cross_attn_token_to_image: Attention,
    pub norm2: LayerNorm,
    pub mlp: MlpBlock,
    pub norm3: LayerNorm,
    pub norm4: LayerNorm,
    pub cross_attn_image_to_token: Attention,
}

/// Multi-head attention whose heads may be narrower than the tokens.
#[derive(Module, Debug)]
pub struct Attention {
    pub q_proj: Linear,
    pub k_proj: Linear,
    pub v_proj: Linear,
    pub out_proj: Linear,
}

impl TwoWayTransformer {
    pub(super) fn new(sizes: &DecoderSizes, device: &Device) -> Self {
        Self {
            layers: (0..sizes.depth).map(|_| TwoWayAttentionBlock::new(sizes, device)).collect(),
            final_attn_token_to_image: Attention::new(sizes.width, sizes.attention_width, device),
            norm_final_attn: layer_norm(sizes.width, device),
        }
    }

    /// Tokens `[P, N, D]` of P prompts, image `[1, T, D]` and the positions of its patches `[1, T, D]` to tokens and image
    /// of each prompt, `[P, N, D]` and `[P, T, D]`.
    pub fn forward(
        &self,
        tokens: Tensor<3>,
        image: Tensor<3>,
        positions: Tensor<3>,
    ) -> (Tensor<3>, Tensor<3>) {
        let (mut queries, mut keys) = (tokens.clone(), image);
        for (index, layer) in self.layers.iter().enumerate() {
            (queries, keys) = layer.forward(queries, keys, &tokens, &positions, index == 0);
        }
        let placed = keys.clone() + positions;
        let read = self.final_attn_token_to_image.few_to_many(queries.clone() + tokens, placed, keys.clone());
        (self.norm_final_attn.forward(queries + read), keys)
    }
}

fn layer_norm(width: usize, device: &Device) -> LayerNorm {
    LayerNormConfig::new(width).with_epsilon(LAYER_NORM_EPSILON).init(device)
}

impl TwoWayAttentionBlock {
    fn new(sizes: &DecoderSizes, device: &Device) -> Self {
        let width = sizes.width;
        let norm = || layer_norm(width, device);
        let cross = || Attention::new(width, sizes.attention_width, device);
        Self {
            self_attn: Attention::new(width, width, device),
            norm1: norm(),
            cross_attn_token_to_image: cross(),
            norm2: norm(),
            mlp: MlpBlock {
                lin1: linear(width, sizes.mlp_width, device),
                lin2: linear(sizes.mlp_width, width, device),
            },
            norm3: norm(),
            norm4: norm(),
            cross_attn_image_to_token: cross(),
        }
    }

    /// `tokens` are the prompts as they were before the first block, which has no other queries yet.
    fn forward(
        &self,
        queries: Tensor<3>,
        keys: Tensor<3>,
        tokens: &Tensor<3>,
        positions: &Tensor<3>,
        first: bool,
    ) -> (Tensor<3>, Tensor<3>) {
        let queries = match first {
            true => self.self_attn.forward(queries.clone(), queries.clone(), queries),
            false => {
                let placed = queries.clone() + tokens.clone();
                queries.clone() + self.self_attn.forward(placed.clone(), placed, queries)
            }
        };
        let queries = self.norm1.forward(queries);

        let placed = keys.clone() + positions.clone();
        let with_prompts = queries.clone() + tokens.clone();
        let read = self.cross_attn_token_to_image.few_to_many(with_prompts, placed.clone(), keys.clone());
        let queries = self.norm2.forward(queries + read);

        let hidden = relu(self.mlp.lin1.forward(queries.clone()));
        let queries = self.norm3.forward(queries + self.mlp.lin2.forward(hidden));

        let with_prompts = queries.clone() + tokens.clone();
        let read = self.cross_attn_image_to_token.many_to_few(placed, with_prompts, queries.clone());
        let keys = keys.expand(read.dims());
        (queries, self.norm4.forward(read + keys))
    }
}

impl Attention {
    fn new(width: usize, inner: usize, device: &Device) -> Self {
        Self {
            q_proj: linear(width, inner, device),
            k_proj: linear(width, inner, device),
            v_proj: linear(width, inner, device),
            out_proj: linear(inner, width, device),
        }
    }

    /// `q` `[P, N, D]` attends to `k` `[P, M, D]` and reads `v`.
    fn forward(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        let (q, k, v) = (self.q_proj.forward(q), self.k_proj.forward(k), self.v_proj.forward(v));
        let scores = of_heads(q).matmul(of_heads(k).swap_dims(2, 3)) * self.scale();
        self.out_proj.forward(joined(softmax(scores, 3).matmul(of_heads(v))))
    }

    /// [`Self::forward`] of few queries `[P, N, D]` with many keys `[P or 1, T, D]`.
    fn few_to_many(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        let [prompts, few, width] = q.dims();
        let q = of_heads(self.q_proj.forward(q)) * self.scale(); // [P, H, N, d]
        // The bias of the keys adds the same to all scores of a query.
        let q = q.matmul(projection_of_heads(&self.k_proj).swap_dims(2, 3)); // [P, H, N, D]
        // Keys that all prompts share make one product of them.
        let groups = k.dims()[0];
        let q = q.reshape([groups, prompts / groups * HEADS * few, width]);
        let weights = softmax(q.matmul(k.swap_dims(1, 2)), 2); // [P, H N, T]
        let read = weights.matmul(v).reshape([prompts, HEADS, few, width]);
        let read = joined(read.matmul(projection_of_heads(&self.v_proj))); // [P, N, C]
        let read = match &self.v_proj.bias {
            Some(bias) => read + bias.val().unsqueeze(),
            None => read,
        };
        self.out_proj.forward(read)
    }

    /// [`Self::forward`] of many queries `[P or 1, T, D]` with few keys `[P, N, D]`.
    fn many_to_few(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        let [prompts, few, width] = k.dims();
        let many = q.dims()[1];
        let k = of_heads(self.k_proj.forward(k)) * self.scale(); // [P, H, N, d]
        let projected = k.clone().matmul(projection_of_heads(&self.q_proj).swap_dims(2, 3)); // [P, H, N, D]
        let projected = projected.reshape([prompts, HEADS * few, width]).swap_dims(1, 2);
        let mut scores = q.matmul(projected); // [P, T, H N]
        if let Some(bias) = &self.q_proj.bias {
            let inner = bias.dims()[0];
            let bias = bias.val().reshape([1, HEADS, inner / HEADS, 1]);
            scores = scores + k.matmul(bias).reshape([prompts, 1, HEADS * few]);
        }
        let weights = softmax(scores.reshape([prompts, many, HEADS, few]), 3);
        let weights = weights.reshape([prompts, many, HEADS * few]);
        // What each token adds to the output, with a share of the bias: the weights of a head sum to 1.
        let out = self.out_proj.weight.val(); // [C, D]
        let inner = out.dims()[0];
        let out = out.reshape([1, HEADS, inner / HEADS, width]);
        let added = of_heads(self.v_proj.forward(v)).matmul(out); // [P, H, N, D]
        let added = match &self.out_proj.bias {
            Some(bias) => added + (bias.val() / HEADS as f64).unsqueeze(),
            None => added,
        };
        weights.matmul(added.reshape([prompts, HEADS * few, width]))
    }

    fn scale(&self) -> f64 {
        let [_, inner] = self.q_proj.weight.dims();
        ((inner / HEADS) as f64).powf(-0.5)
    }
}

/// `[P, N, H d]` to `[P, H, N, d]`.
fn of_heads(x: Tensor<3>) -> Tensor<4> {
    let [batch, count, width] = x.dims();
    x.reshape([batch, count, HEADS, width / HEADS]).swap_dims(1, 2)
}

/// Back from [`of_heads`].
fn joined(x: Tensor<4>) -> Tensor<3> {
    let [batch, heads, count, width] = x.dims();
    x.swap_dims(1, 2).reshape([batch, count, heads * width])
}

/// Weight of a projection for each head, `[1, H, D, d]`.
fn projection_of_heads(projection: &Linear) -> Tensor<4> {
    let [input, inner] = projection.weight.dims();
    let weight: Tensor<3> = projection.weight.val().reshape([input, HEADS, inner / HEADS]);
    weight.swap_dims(0, 1).unsqueeze()
}
