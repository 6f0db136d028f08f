//! Training losses: per stage and block InfoNCE, overlap and saliency (paper, "Details of Training Objectives"; the
//! saliency term, thresholds and factors are the release's).

mod labels;
mod terms;

pub use labels::{MatchLabels, pairwise_distance};
pub use terms::{info_nce, soft_correspondence, weighted_bce};

use burn::tensor::Tensor;

use crate::{
    config::LossConfig,
    model::{BlockOutput, CloudTensors, MatchingOutputs, PairTensors},
};

/// The loss of a batch and its parts.
#[derive(Clone, Debug)]
pub struct Losses {
    /// Mean over the batch of each pair's clamped sum, `[1]`.
    pub total: Tensor<1>,
    /// Each term's value per pair `[B]`, named `stage.block.term`.
    pub terms: Vec<(String, Tensor<1>)>,
}

/// All terms of all blocks of both stages.
pub fn pair_losses(config: &LossConfig, outputs: &MatchingOutputs, batch: &PairTensors) -> Losses {
    let labels = |query: Tensor<3>, reference: Tensor<3>| {
        MatchLabels::new(query, reference, &batch.pose, config.match_distance, config.overlap_distance)
    };
    let coarse = labels(sparse(&batch.query), sparse(&batch.reference));
    let mut terms = stage_terms("coarse", config, &outputs.coarse, &coarse);
    if !outputs.fine.is_empty() {
        let fine = labels(batch.query.points.clone(), batch.reference.points.clone());
        terms.extend(stage_terms("fine", config, &outputs.fine, &fine));
    }
    total(config, terms)
}

/// Sums weighted terms per pair, clamps, averages.
fn total(config: &LossConfig, weighted: Vec<(String, f32, Tensor<1>)>) -> Losses {
    let sum = weighted.iter().map(|(_, weight, value)| value.clone() * *weight).reduce(|a, b| a + b);
    let device = Default::default();
    let total = sum.unwrap_or_else(|| Tensor::zeros([1], &device)).clamp_max(config.clamp).mean();
    Losses { total, terms: weighted.into_iter().map(|(name, _, value)| (name, value)).collect() }
}

fn stage_terms(
    stage: &str,
    config: &LossConfig,
    blocks: &[BlockOutput],
    labels: &MatchLabels,
) -> Vec<(String, f32, Tensor<1>)> {
    let mut terms = Vec::new();
    for (index, block) in blocks.iter().enumerate() {
        let mut push = |term: &str, weight: f32, value: &dyn Fn() -> Option<Tensor<1>>| {
            if weight > 0.0
                && let Some(value) = value()
            {
                terms.push((format!("{stage}.{index}.{term}"), weight, value));
            }
        };
        let balanced = |logits: Option<[Tensor<2>; 2]>| {
            logits.map(|both| weighted_bce(Tensor::cat(both.to_vec(), 1), labels.overlap.clone()))
        };
        push("info_nce", 1.0, &|| Some(info_nce(&block.similarity, labels, config)));
        push("overlap", config.overlap_weight, &|| balanced(block.overlap.clone()));
        push("saliency", config.saliency_weight, &|| balanced(block.saliency()));
        push("correspondence", config.correspondence_weight, &|| {
            Some(soft_correspondence(block, labels, config))
        });
    }
    terms
}

/// Sparse points `[B, M, 3]`.
fn sparse(cloud: &CloudTensors) -> Tensor<3> {
    let [batch, n, _] = cloud.points.dims();
    let rows = cloud.sparse_points.dims()[0];
    cloud.points.clone().reshape([batch * n, 3]).select(0, cloud.sparse_points.clone()).reshape([
        batch,
        rows / batch,
        3,
    ])
}
