//! Training losses: per stage and block InfoNCE, overlap and saliency (paper, "Details of Training Objectives"; the
//! saliency term, thresholds and factors are the release's).

mod distil;
mod labels;
mod proposals;
mod terms;

pub use distil::{FeaturePair, distil_losses, structure};
pub use labels::{MatchLabels, pairwise_distance};
pub use proposals::{SceneBatch, proposal_losses};
pub use terms::{info_nce, soft_correspondence, weighted_bce};

use burn::tensor::Tensor;
use unopose_core::config::LossConfig;

use crate::model::{BlockOutput, MatchingOutputs, PairTensors, SparseRows};

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
    let coarse =
        labels(sparse(&batch.points[0], &batch.query.rows), sparse(&batch.points[1], &batch.reference.rows));
    let mut terms = stage_terms("coarse", config, &outputs.coarse, &coarse);
    if !outputs.fine.is_empty() {
        let fine = labels(batch.points[0].clone(), batch.points[1].clone());
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
        push("overlap", config.overlap_weight, &|| match &block.background_overlap {
            None => balanced(block.overlap.clone()),
            Some(background) => overlap_per_cloud(block.overlap.as_ref()?, background, labels),
        });
        push("saliency", config.saliency_weight, &|| balanced(block.saliency()));
        push("correspondence", config.correspondence_weight, &|| {
            Some(soft_correspondence(block, labels, config))
        });
    }
    terms
}

/// The paper's overlap term: WBCE of the query's tokens plus WBCE of the reference's, the background's target being 0:
/// `[B]`.
fn overlap_per_cloud(
    points: &[Tensor<2>; 2],
    background: &[Tensor<2>; 2],
    labels: &MatchLabels,
) -> Option<Tensor<1>> {
    let [batch, n] = points[0].dims();
    let m = points[1].dims()[1];
    let targets = [0..n, n..n + m].map(|range| labels.overlap.clone().slice([0..batch, range]));
    let terms = points.iter().zip(background).zip(targets).map(|((points, background), target)| {
        let none = Tensor::zeros([batch, 1], &target.device());
        weighted_bce(
            Tensor::cat(vec![background.clone(), points.clone()], 1),
            Tensor::cat(vec![none, target], 1),
        )
    });
    terms.reduce(|query, reference| query + reference)
}

/// Sparse points `[B, M, 3]`.
fn sparse(points: &Tensor<3>, rows: &SparseRows) -> Tensor<3> {
    let [batch, n, _] = points.dims();
    let m = rows.points.dims()[0] / batch;
    points.clone().reshape([batch * n, 3]).select(0, rows.points.clone()).reshape([batch, m, 3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn overlap_in_the_papers_form_counts_the_background_as_a_negative() {
        let device = Device::flex();
        let row = |values: &[f32]| {
            Tensor::<2>::from_data(TensorData::new(values.to_vec(), [1, values.len()]), &device)
        };
        let labels = MatchLabels {
            distances: Tensor::zeros([1, 2, 1], &device),
            query: Tensor::zeros([1, 2], &device),
            reference: Tensor::zeros([1, 1], &device),
            overlap: row(&[1.0, 0.0, 1.0]),
        };
        let points = [row(&[0.0, 0.0]), row(&[0.0])];
        let background = [row(&[3f32.ln()]), row(&[0.0])];
        let loss = overlap_per_cloud(&points, &background, &labels).unwrap().into_scalar::<f32>();
        // Query: targets 0 1 0, a third positive; log probabilities of the truth -ln 4, -ln 2, -ln 2:
        // (1/3 * 2 + 2/3 * 1 + 1/3 * 1) ln 2 / 3. Reference: targets 0 1, half and half: ln 2 / 2.
        let expected = (5.0 / 9.0 + 0.5) * 2f32.ln();
        assert!((loss - expected).abs() < 1e-6, "{loss}, by hand {expected}");
    }
}
