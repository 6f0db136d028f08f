//! The loss terms, one value per pair of the batch.

use burn::tensor::{Device, IndexingUpdateOp, Int, Tensor, activation::log_sigmoid};
use unopose_core::config::LossConfig;

use super::labels::MatchLabels;
use crate::model::BlockOutput;

/// InfoNCE in both directions: `[B]`.
///
/// The similarities are cosines over a temperature, so they are bounded by 1/temperature and their exponentials can be
/// summed without subtracting the maximum; rows and columns share one exponential. The gradient with respect to the
/// similarities is written down (softmax minus target, in both directions) instead of taped, which leaves a fraction of
/// the passes over the `[B, 1 + N, 1 + M]` matrices.
pub fn info_nce(similarity: &Tensor<3>, labels: &MatchLabels, config: &LossConfig) -> Tensor<1> {
    let [batch, rows, columns] = similarity.dims();
    let (n, m) = (rows - 1, columns - 1);
    let half = if config.halve_info_nce { 0.5 } else { 1.0 };
    let s = similarity.clone().inner();
    let exp = s.clone().exp();
    let row_sum = exp.clone().sum_dim(2); // [B, 1 + N, 1]
    let column_sum = exp.clone().sum_dim(1); // [B, 1, 1 + M]

    // Targets of the background's own row and column are irrelevant: their weight is 0.
    let query = with_background(labels.query.clone()).unsqueeze_dim::<3>(2); // [B, 1 + N, 1]
    let reference = with_background(labels.reference.clone()).unsqueeze_dim::<3>(1); // [B, 1, 1 + M]
    let row_weight = point_weights(batch, n, half, &s.device()).unsqueeze_dim::<3>(2);
    let column_weight = point_weights(batch, m, half, &s.device()).unsqueeze_dim::<3>(1);
    let row_loss = (row_sum.clone().log() - s.clone().gather(2, query.clone())) * row_weight.clone();
    let column_loss = (column_sum.clone().log() - s.gather(1, reference.clone())) * column_weight.clone();
    let value = row_loss.reshape([batch, rows]).sum_dim(1) + column_loss.reshape([batch, columns]).sum_dim(1);
    let value = value.reshape([batch]);
    if !similarity.is_autodiff() {
        return value;
    }
    let gradient = (exp * (row_weight.clone() / row_sum + column_weight.clone() / column_sum))
        .scatter(2, query, row_weight.neg(), IndexingUpdateOp::Add)
        .scatter(1, reference, column_weight.neg(), IndexingUpdateOp::Add);
    let linear = (similarity.clone() * gradient).reshape([batch, rows * columns]).sum_dim(1).reshape([batch]);
    linear.clone() - linear.detach() + value
}

/// 0 for the background, `half / n` for the `n` points: `[B, 1 + n]`.
fn point_weights(batch: usize, n: usize, half: f32, device: &Device) -> Tensor<2> {
    let points = Tensor::full([batch, n], half / n as f32, device);
    Tensor::cat(vec![Tensor::zeros([batch, 1], device), points], 1)
}

/// `[B, n] -> [B, 1 + n]` with label 0 in front.
fn with_background(labels: Tensor<2, Int>) -> Tensor<2, Int> {
    let [batch, _] = labels.dims();
    Tensor::cat(vec![Tensor::zeros([batch, 1], &labels.device()), labels], 1)
}

/// Class-balanced binary cross entropy of logits `[B, n]` against 0/1 targets: positives weigh the negative share,
/// negatives the positive share, per pair; mean over the points: `[B]`. Logarithms are clamped at -100.
pub fn weighted_bce(logits: Tensor<2>, target: Tensor<2>) -> Tensor<1> {
    let batch = logits.dims()[0];
    let positive_share = target.clone().mean_dim(1); // [B, 1]
    let negative = target.clone().neg() + 1.0;
    let log_p = log_sigmoid(logits.clone()).clamp_min(-100.0);
    let log_not_p = log_sigmoid(logits.neg()).clamp_min(-100.0);
    let positive_weight = target * (positive_share.clone().neg() + 1.0);
    let loss = positive_weight * log_p + negative * positive_share * log_not_p;
    loss.neg().mean_dim(1).reshape([batch])
}

/// Soft correspondences (CoFiNet, eq. 8, on points): mean negative log assignment (row softmax times column softmax)
/// over all pairs, weighted by their true overlap `max(0, 1 - distance / overlap_distance)`: `[B]`.
pub fn soft_correspondence(output: &BlockOutput, labels: &MatchLabels, config: &LossConfig) -> Tensor<1> {
    let [batch, rows, columns] = output.similarity.dims();
    let exp = output.similarity.clone().exp();
    let log_assignment =
        output.similarity.clone() * 2.0 - exp.clone().sum_dim(2).log() - exp.sum_dim(1).log(); // [B, 1 + N, 1 + M]
    let weight = (labels.distances.clone() / -config.overlap_distance + 1.0).clamp_min(0.0); // [B, N, M]
    let inner = log_assignment.slice([0..batch, 1..rows, 1..columns]);
    let sum = |x: Tensor<3>| x.reshape([batch, (rows - 1) * (columns - 1)]).sum_dim(1);
    (sum(inner * weight.clone()).neg() / (sum(weight) + 1e-6)).reshape([batch])
}
