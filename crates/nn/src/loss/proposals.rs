//! What the proposal network is to minimise (`docs/network.md`, section 13).

use burn::tensor::{Device, Tensor, TensorData, activation::log_sigmoid, activation::log_softmax};
use unopose_core::config::ProposalConfig;
use unopose_pairs::data::{CLASSES, INPUT_CHANNELS, SceneInput, SceneTarget};

use super::Losses;
use crate::model::ProposalOutput;

/// Metres that a vote's error is counted in.
const VOTE_UNIT: f32 = 0.1;

/// A batch of images with what is to be said of them.
#[derive(Clone, Debug)]
pub struct SceneBatch {
    /// `[B, 12, H, W]`.
    pub input: Tensor<4>,
    /// The weight of each cell at its class, 0 at the others, `[B, 3, H, W]`.
    pub classes: Tensor<4>,
    /// True votes, metres, `[B, 3, H, W]`.
    pub votes: Tensor<4>,
    /// Weights of the votes, 0 off the instances, `[B, 1, H, W]`.
    pub vote_weights: Tensor<4>,
    /// 1 on boundaries, else 0, `[B, 1, H, W]`.
    pub boundary: Tensor<4>,
    /// `[B, 1, H, W]`.
    pub boundary_weights: Tensor<4>,
}

impl SceneBatch {
    /// On `device`; all inputs have one size.
    pub fn new<'a>(scenes: impl Iterator<Item = (&'a SceneInput, &'a SceneTarget)>, device: &Device) -> Self {
        let mut values: [Vec<f32>; 6] = Default::default();
        let (mut batch, mut size) = (0, [0, 0]);
        for (input, target) in scenes {
            size = [input.height, input.width];
            batch += 1;
            let area = input.len();
            let [inputs, classes, votes, vote_weights, boundary, boundary_weights] = &mut values;
            inputs.extend_from_slice(&input.values);
            for class in 0..CLASSES {
                classes.extend((0..area).map(|cell| match usize::from(target.classes[cell]) == class {
                    true => target.weights[cell],
                    false => 0.0,
                }));
            }
            for axis in 0..3 {
                votes.extend(target.votes.iter().map(|vote| vote[axis]));
            }
            vote_weights.extend((0..area).map(|cell| match target.classes[cell] {
                0 => target.weights[cell],
                _ => 0.0,
            }));
            boundary.extend(target.boundary.iter().map(|&on| f32::from(u8::from(on))));
            boundary_weights.extend_from_slice(&target.boundary_weights);
        }
        let [inputs, classes, votes, vote_weights, boundary, boundary_weights] = values;
        let tensor = |values: Vec<f32>, channels: usize| {
            Tensor::from_data(TensorData::new(values, [batch, channels, size[0], size[1]]), device)
        };
        Self {
            input: tensor(inputs, INPUT_CHANNELS),
            classes: tensor(classes, CLASSES),
            votes: tensor(votes, 3),
            vote_weights: tensor(vote_weights, 1),
            boundary: tensor(boundary, 1),
            boundary_weights: tensor(boundary_weights, 1),
        }
    }
}

/// Weighted cross entropy of the classes, Huber loss of the votes (in units of 10 cm, summed over the axes, weighted mean over
/// the foreground), weighted binary cross entropy of the boundaries. Each term is a weighted mean over the cells of an image;
/// an image without foreground has no vote loss.
pub fn proposal_losses(config: &ProposalConfig, output: &ProposalOutput, batch: &SceneBatch) -> Losses {
    let log_class = log_softmax(output.classes.clone(), 1);
    let classes = weighted_mean((log_class * batch.classes.clone()).sum_dim(1).neg(), {
        batch.classes.clone().sum_dim(1)
    });
    let error = (output.votes.clone() - batch.votes.clone()) / VOTE_UNIT;
    let huber = huber(error, config.vote_huber / f64::from(VOTE_UNIT)).sum_dim(1); // [B, 1, H, W]
    let votes = weighted_mean(huber * batch.vote_weights.clone(), batch.vote_weights.clone());
    let (on, logits) = (batch.boundary.clone(), output.boundary.clone());
    let off = on.clone().neg() + 1.0;
    let entropy = (on * log_sigmoid(logits.clone()) + off * log_sigmoid(logits.neg())).neg();
    let boundary = weighted_mean(entropy * batch.boundary_weights.clone(), batch.boundary_weights.clone());
    let total = (classes.clone() * config.class_weight
        + votes.clone() * config.vote_weight
        + boundary.clone() * config.boundary_weight)
        .mean();
    let terms = [("class", classes), ("vote", votes), ("boundary", boundary)];
    Losses { total, terms: terms.into_iter().map(|(name, value)| (name.to_owned(), value)).collect() }
}

/// `e^2 / (2 delta)` below `delta`, `|e| - delta / 2` from there on.
fn huber(error: Tensor<4>, delta: f64) -> Tensor<4> {
    let size = error.abs();
    let near = size.clone().clamp_max(delta);
    // With n = min(|e|, delta): n^2 / (2 delta) + |e| - n.
    near.clone() * near.clone() / (2.0 * delta) + size - near
}

/// Sum of `weighted` over the sum of `weights`, per image: `[B]`.
fn weighted_mean(weighted: Tensor<4>, weights: Tensor<4>) -> Tensor<1> {
    let batch = weighted.dims()[0];
    let sum = |x: Tensor<4>| {
        let cells = x.dims()[1..].iter().product::<usize>();
        x.reshape([batch, cells]).sum_dim(1).reshape([batch])
    };
    sum(weighted) / (sum(weights) + 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_by_hand() {
        let device = Device::flex();
        let tensor = |values: &[f32], channels: usize| {
            Tensor::<4>::from_data(TensorData::new(values.to_vec(), [1, channels, 1, 2]), &device)
        };
        // Two cells: foreground of weight 2 with logits (ln 2, 0, 0), support of weight 1 with equal logits.
        let output = ProposalOutput {
            classes: tensor(&[2f32.ln(), 0.0, 0.0, 0.0, 0.0, 0.0], 3),
            votes: tensor(&[0.01, 9.0, 0.0, 9.0, 0.05, 9.0], 3),
            boundary: tensor(&[3f32.ln(), 0.0], 1),
        };
        let batch = SceneBatch {
            input: tensor(&[0.0; 24], 12),
            classes: tensor(&[2.0, 0.0, 0.0, 1.0, 0.0, 0.0], 3),
            votes: tensor(&[0.0; 6], 3),
            vote_weights: tensor(&[2.0, 0.0], 1),
            boundary: tensor(&[1.0, 0.0], 1),
            boundary_weights: tensor(&[3.0, 0.5], 1),
        };
        let config = ProposalConfig {
            vote_huber: 0.02,
            class_weight: 1.0,
            vote_weight: 3.0,
            boundary_weight: 0.5,
            ..ProposalConfig::default()
        };
        let losses = proposal_losses(&config, &output, &batch);
        // Errors of 0.1 and 0.5 units with delta 0.2: 0.01 / 0.4 + (0.5 - 0.1).
        let expected = [
            (2.0 * 2f32.ln() + 3f32.ln()) / 3.0,
            0.025 + 0.4,
            (3.0 * (4f32 / 3.0).ln() + 0.5 * 2f32.ln()) / 3.5,
        ];
        for ((name, value), expected) in losses.terms.iter().zip(expected) {
            let value = value.clone().into_scalar::<f32>();
            assert!((value - expected).abs() < 1e-5, "{name}: {value}, by hand {expected}");
        }
        let total = losses.total.into_scalar::<f32>();
        assert!((total - (expected[0] + 3.0 * expected[1] + 0.5 * expected[2])).abs() < 1e-5, "{total}");
    }
}
