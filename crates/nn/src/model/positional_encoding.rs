//! Positional encoding of the fine stage: a two-scale PointNet over ball neighbourhoods with offsets and local
//! reference frame coordinates.

use burn::{module::Module, nn::Linear, tensor::Tensor};
use unopose_core::config::FineConfig;

use super::{
    batch_norm::RowBatchNorm,
    fused::{linear_relu, linear_relu_max, shared_layers_max},
    init::Initializer,
};

/// Batch norm under the release's name.
#[derive(Module, Debug)]
pub struct NormLayer {
    pub bn: RowBatchNorm,
}

/// 1x1 convolution without bias, batch norm, ReLU.
#[derive(Module, Debug)]
pub struct SharedLayer {
    pub conv: Linear,
    pub normlayer: NormLayer,
}

/// Three shared layers.
#[derive(Module, Debug)]
pub struct SharedMlp {
    pub layer0: SharedLayer,
    pub layer1: SharedLayer,
    pub layer2: SharedLayer,
}

/// Final 1x1 convolution with bias.
#[derive(Module, Debug)]
pub struct OutputConv {
    pub conv: Linear,
}

/// Two neighbourhood scales, concatenated and mapped to the transformer's width.
#[derive(Module, Debug)]
pub struct PositionalEncoding {
    /// Shared layers of the smaller neighbourhoods.
    pub mlp1: SharedMlp,
    /// Shared layers of the larger neighbourhoods.
    pub mlp2: SharedMlp,
    /// Map of both scales to the tokens' width.
    pub mlp3: OutputConv,
    use_lrf: bool,
}

/// Neighbourhoods of one cloud at one scale.
#[derive(Clone, Debug)]
pub struct GroupTensors {
    /// Offset and LRF coordinates of every neighbour, `[B, N, K, 6]`.
    pub features: Tensor<4>,
    /// True neighbours of every centre, `[B * N]`.
    pub counts: Vec<u32>,
    /// 1 for true neighbours, 0 for padding, `[B * N * K, 1]`; `None`: padding counts in the batch statistics.
    pub mask: Option<Tensor<2>>,
}

impl SharedMlp {
    fn new(input: usize, channels: [usize; 3], init: &mut Initializer) -> Self {
        let mut layer = |d_input, d_output| SharedLayer {
            conv: init.linear_relu(d_input, d_output),
            normlayer: NormLayer { bn: RowBatchNorm::new(d_output, init) },
        };
        Self {
            layer0: layer(input, channels[0]),
            layer1: layer(channels[0], channels[1]),
            layer2: layer(channels[1], channels[2]),
        }
    }

    /// Max over the neighbours of the mapped features: `[B, N, C]`.
    fn forward(&self, groups: &GroupTensors, inputs: usize) -> Tensor<3> {
        let [batch, n, k, channels] = groups.features.dims();
        let mut x = groups.features.clone().reshape([batch * n * k, channels]);
        if inputs < channels {
            x = x.slice([0..batch * n * k, 0..inputs]);
        }
        let layers = [&self.layer0, &self.layer1, &self.layer2];
        let pooled = if self.layer0.conv.weight.val().is_autodiff() {
            let [first, second, last] = layers.map(|layer| {
                |x: &Tensor<2>| layer.normlayer.bn.fold_batch(&layer.conv, x, groups.mask.clone())
            });
            let (weight, shift) = first(&x);
            let x = linear_relu(x, weight, shift);
            let (weight, shift) = second(&x);
            let x = linear_relu(x, weight, shift);
            let (weight, shift) = last(&x);
            linear_relu_max(x, weight, shift, k)
        } else {
            let layers = layers.map(|layer| layer.normlayer.bn.fold(&layer.conv));
            shared_layers_max(x, &layers, k, &groups.counts)
        };
        // Padding repeats a true neighbour, so the maximum does not see it.
        let width = pooled.dims()[1];
        pooled.reshape([batch, n, width])
    }
}

impl PositionalEncoding {
    /// Initial weights.
    pub fn new(config: &FineConfig, init: &mut Initializer) -> Self {
        let inputs = if config.use_lrf { 6 } else { 3 };
        let mlp1 = SharedMlp::new(inputs, config.pe_channels, init);
        let mlp2 = SharedMlp::new(inputs, config.pe_channels, init);
        let joined = 2 * config.pe_channels[2];
        let mut conv = init.linear_relu(joined, config.matching.hidden_dim);
        conv.bias = Some(init.constant([config.matching.hidden_dim], 0.0));
        Self { mlp1, mlp2, mlp3: OutputConv { conv }, use_lrf: config.use_lrf }
    }

    /// `[B, N, hidden_dim]`.
    pub fn forward(&self, groups: &[GroupTensors; 2]) -> Tensor<3> {
        let inputs = if self.use_lrf { 6 } else { 3 };
        let small = self.mlp1.forward(&groups[0], inputs);
        let large = self.mlp2.forward(&groups[1], inputs);
        self.mlp3.conv.forward(Tensor::cat(vec![small, large], 2))
    }
}
