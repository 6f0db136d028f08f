//! The network that proposes objects (`docs/network.md`, section 13), in the spirit of unseen-object segmentation from synthetic
//! RGB-D (Xie et al., "Unseen Object Instance Segmentation for Robotic Environments", 2021: votes for the objects' centres in
//! 3-D): a small U-Net with a stream for depth and one for colour.

use burn::{
    module::Module,
    nn::conv::{Conv2d, Conv2dConfig},
    tensor::{
        Device, Tensor, TensorData,
        activation::{relu, sigmoid, softmax},
    },
};
use unopose_core::config::ProposalConfig;
use unopose_pairs::data::{CLASSES, GEOMETRY_CHANNELS, INPUT_CHANNELS, ProposalMaps, SceneInput};

use super::{conv_encoder::conv, init::Initializer};

/// Answers per cell: classes, votes, boundary.
const OUTPUTS: usize = CLASSES + 3 + 1;
/// Metres per unit of the votes' channels.
const VOTE_SCALE: f32 = 0.1;

/// From the grid's channels to class, vote and boundary of every cell.
#[derive(Module, Debug)]
pub struct ProposalNetwork {
    /// Depth at half resolution.
    pub depth_stem: Conv2d,
    /// Colour at half resolution.
    pub color_stem: Conv2d,
    /// To a quarter, an eighth and a sixteenth.
    pub down: Vec<Conv2d>,
    /// Residual convolutions, one for each of `down`, one more for the last.
    pub residual: Vec<Conv2d>,
    /// Back to an eighth, a quarter and a half, with the features from there.
    pub up: Vec<Conv2d>,
    /// The four cells under each of a half's.
    pub head: Conv2d,
}

/// What the network says of every cell.
#[derive(Clone, Debug)]
pub struct ProposalOutput {
    /// Logits of foreground, support and background, `[B, 3, H, W]`.
    pub classes: Tensor<4>,
    /// From the cell's point to the centre of its instance, metres, `[B, 3, H, W]`.
    pub votes: Tensor<4>,
    /// Logits of being on the boundary of an instance, `[B, 1, H, W]`.
    pub boundary: Tensor<4>,
}

impl ProposalNetwork {
    /// A freshly initialised network; the same seed gives the same weights on every device.
    pub fn new(config: &ProposalConfig, seed: u64, device: &Device) -> Self {
        let init = &mut Initializer::new(seed, device);
        let [half, quarter, eighth, sixteenth] = config.channels;
        let fused = 2 * half;
        Self {
            depth_stem: conv(GEOMETRY_CHANNELS, half, 2, init),
            color_stem: conv(INPUT_CHANNELS - GEOMETRY_CHANNELS, half, 2, init),
            down: vec![
                conv(fused, quarter, 2, init),
                conv(quarter, eighth, 2, init),
                conv(eighth, sixteenth, 2, init),
            ],
            residual: vec![
                conv(quarter, quarter, 1, init),
                conv(eighth, eighth, 1, init),
                conv(sixteenth, sixteenth, 1, init),
                conv(sixteenth, sixteenth, 1, init),
            ],
            up: vec![
                conv(sixteenth + eighth, eighth, 1, init),
                conv(eighth + quarter, quarter, 1, init),
                conv(quarter + fused, fused, 1, init),
            ],
            head: head(fused, init),
        }
    }

    /// Of inputs `[B, 12, H, W]` as [`unopose_pairs::data::SceneInput`] has them, `H` and `W` multiples of 16.
    pub fn forward(&self, input: Tensor<4>) -> ProposalOutput {
        let colors = input.dims()[1] - GEOMETRY_CHANNELS;
        let depth = relu(self.depth_stem.forward(input.clone().narrow(1, 0, GEOMETRY_CHANNELS)));
        let color = relu(self.color_stem.forward(input.narrow(1, GEOMETRY_CHANNELS, colors)));
        let mut x = Tensor::cat(vec![depth, color], 1); // [B, 2 c0, H/2, W/2]
        let mut skips = Vec::new();
        for (down, residual) in self.down.iter().zip(&self.residual) {
            skips.push(x.clone());
            x = relu(down.forward(x));
            x = relu(residual.forward(x.clone())) + x;
        }
        for residual in self.residual.iter().skip(self.down.len()) {
            x = relu(residual.forward(x.clone())) + x; // [B, c3, H/16, W/16]
        }
        for (up, skip) in self.up.iter().zip(skips.into_iter().rev()) {
            x = relu(up.forward(Tensor::cat(vec![doubled(x), skip], 1)));
        }
        let answers = cells_of(self.head.forward(x)); // [B, 7, H, W]
        ProposalOutput {
            classes: answers.clone().narrow(1, 0, CLASSES),
            votes: answers.clone().narrow(1, CLASSES, 3) * VOTE_SCALE,
            boundary: answers.narrow(1, CLASSES + 3, 1),
        }
    }

    /// What a network without autodiff says of one image, on the host.
    pub fn maps(&self, input: &SceneInput) -> ProposalMaps {
        let shape = [1, INPUT_CHANNELS, input.height, input.width];
        let device = self.head.weight.device();
        self.forward(Tensor::from_data(TensorData::new(input.values.clone(), shape), &device)).maps(0)
    }
}

impl ProposalOutput {
    /// Probabilities and votes of one image of the batch, on the host.
    pub fn maps(&self, index: usize) -> ProposalMaps {
        let of_image = |x: &Tensor<4>| x.clone().narrow(0, index, 1);
        let host = |x: Tensor<4>| -> Vec<f32> { x.into_data().iter::<f32>().collect() };
        let foreground = softmax(of_image(&self.classes), 1).narrow(1, 0, 1);
        let votes = host(of_image(&self.votes));
        let area = votes.len() / 3;
        let vote = |cell: usize| [votes[cell], votes[area + cell], votes[2 * area + cell]];
        ProposalMaps {
            foreground: host(foreground),
            votes: (0..area).map(vote).collect(),
            boundary: host(sigmoid(of_image(&self.boundary))),
        }
    }
}

/// 1x1 convolution to the answers of four cells, nearly 0 at the beginning.
fn head(input: usize, init: &mut Initializer) -> Conv2d {
    let mut conv = Conv2dConfig::new([input, 4 * OUTPUTS], [1, 1]).init(init.device());
    conv.weight = init.normal([4 * OUTPUTS, input, 1, 1], 0.1 / (input as f64).sqrt());
    conv.bias = Some(init.constant([4 * OUTPUTS], 0.0));
    conv
}

/// Every cell twice along both axes: `[B, C, H, W] -> [B, C, 2 H, 2 W]`.
fn doubled(x: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = x.dims();
    let wide: Tensor<5> =
        x.reshape([batch * channels, height, 1, width, 1]).expand([batch * channels, height, 2, width, 2]);
    wide.reshape([batch, channels, 2 * height, 2 * width])
}

/// Channels of four cells to the cells: `[B, 4 C, H, W] -> [B, C, 2 H, 2 W]`.
fn cells_of(x: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = x.dims();
    let parts: Tensor<6> = x.reshape([batch, channels / 4, 2, 2, height, width]);
    parts.permute([0, 1, 4, 2, 5, 3]).reshape([batch, channels / 4, 2 * height, 2 * width])
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;

    #[test]
    fn every_cell_is_answered_and_the_weights_are_small() {
        let device = Device::flex();
        let network = ProposalNetwork::new(&ProposalConfig::default(), 3, &device);
        let output = network.forward(Tensor::zeros([2, INPUT_CHANNELS, 32, 48], &device));
        assert_eq!(output.classes.dims(), [2, 3, 32, 48]);
        assert_eq!((output.votes.dims(), output.boundary.dims()), ([2, 3, 32, 48], [2, 1, 32, 48]));
        // Two bytes each.
        assert!(2 * network.num_params() < 2_000_000, "{}", network.num_params());
    }

    #[test]
    fn cells_lie_where_their_channels_say() {
        let device = Device::flex();
        let values: Vec<f32> = (0..8).map(|v| v as f32).collect();
        // Four channels of 1 x 2: cell (row, column) of channel 2 row + column.
        let x = Tensor::<4>::from_data(TensorData::new(values, [1, 4, 1, 2]), &device);
        let cells: Vec<f32> = cells_of(x).into_data().iter::<f32>().collect();
        assert_eq!(cells, [0.0, 2.0, 1.0, 3.0, 4.0, 6.0, 5.0, 7.0]);
        let x = Tensor::<4>::from_data(TensorData::new(vec![1.0f32, 2.0], [1, 1, 1, 2]), &device);
        let twice: Vec<f32> = doubled(x).into_data().iter::<f32>().collect();
        assert_eq!(twice, [1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0]);
    }
}
