//! The loss terms, one value per pair of the batch.

use burn::tensor::{Tensor, activation::log_sigmoid};

use super::labels::MatchLabels;
use crate::{config::LossConfig, model::BlockOutput};

/// InfoNCE in both directions: `[B]`.
///
/// The similarities are cosines over a temperature, so they are bounded by 1/temperature and their exponentials can be
/// summed without subtracting the maximum; rows and columns share one exponential.
pub fn info_nce(similarity: &Tensor<3>, labels: &MatchLabels, config: &LossConfig) -> Tensor<1> {
    let [batch, rows, columns] = similarity.dims();
    let exp = similarity.clone().exp();
    // Query points: every column, background included.
    let row_log = exp.clone().sum_dim(2).log().slice([0..batch, 1..rows, 0..1]); // [B, N, 1]
    let row_true = similarity
        .clone()
        .slice([0..batch, 1..rows, 0..columns])
        .gather(2, labels.query.clone().unsqueeze_dim::<3>(2)); // [B, N, 1]
    let query = (row_log - row_true).reshape([batch, rows - 1]).mean_dim(1);
    let column_log = exp.sum_dim(1).log().slice([0..batch, 0..1, 1..columns]); // [B, 1, M]
    let column_true = similarity
        .clone()
        .slice([0..batch, 0..rows, 1..columns])
        .gather(1, labels.reference.clone().unsqueeze_dim::<3>(1)); // [B, 1, M]
    let reference = (column_log - column_true).reshape([batch, columns - 1]).mean_dim(1);
    let sum = (query + reference).reshape([batch]);
    if config.halve_info_nce { sum * 0.5 } else { sum }
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
