//! From a block's similarities and overlaps on the device to assignments on the host.

use burn::tensor::Tensor;
use rayon::prelude::*;
use unopose_core::{
    config::OverlapMode,
    geometry::{Assignment, correlation_assignment, match_assignment},
};
use unopose_nn::model::BlockOutput;

use super::InferError;

/// An assignment on the host with the overlaps behind it.
#[derive(Clone, Debug)]
pub struct Matched {
    /// Weights and labels of all pairs of points.
    pub assignment: Assignment,
    /// Predicted overlap of every query and every reference point, 0..=1.
    pub overlap: [Vec<f32>; 2],
}

impl Matched {
    /// Mean predicted overlap of the query's and the reference's points.
    pub fn mean_overlap(&self) -> [f64; 2] {
        [0, 1].map(|side| {
            let overlap: &[f32] = &self.overlap[side];
            overlap.iter().map(|&x| f64::from(x)).sum::<f64>() / overlap.len().max(1) as f64
        })
    }

    /// Share of the query's points that have a match.
    pub fn matched_share(&self) -> f64 {
        let labels = &self.assignment.label_query;
        labels.iter().filter(|&&label| label > 0).count() as f64 / labels.len().max(1) as f64
    }
}

/// One assignment per pair of the batch, in the form that `mode` names.
///
/// `split_at_reference` (quirk of the coarse stage): the release looks for the reference's overlaps behind as many
/// entries as the reference has points, although the query's come first. Equal counts hide that; others stop it.
pub fn host_assignments(
    block: BlockOutput,
    mode: OverlapMode,
    split_at_reference: bool,
) -> Result<Vec<Matched>, InferError> {
    let [batch, rows, columns] = block.similarity.dims();
    if split_at_reference && mode == OverlapMode::Release && rows != columns {
        return Err(InferError::UnequalCounts { query: rows - 1, reference: columns - 1 });
    }
    let [query, reference] = block.overlap_probability();
    let similarity = host(block.similarity, "similarities")?;
    let (query, reference) = (host(query, "overlaps")?, host(reference, "overlaps")?);
    let matched = (0..batch)
        .into_par_iter()
        .map(|b| {
            let (n, m) = (rows - 1, columns - 1);
            let overlap = [&query[b * n..(b + 1) * n], &reference[b * m..(b + 1) * m]];
            let similarity = &similarity[b * rows * columns..(b + 1) * rows * columns];
            let assignment = match mode {
                // Without overlap heads all overlaps are 1.
                OverlapMode::Release | OverlapMode::Off => {
                    match_assignment(similarity, overlap[0], overlap[1])
                }
                OverlapMode::Paper => correlation_assignment(similarity, n, m),
            };
            Matched { assignment, overlap: overlap.map(<[f32]>::to_vec) }
        })
        .collect();
    Ok(matched)
}

fn host<const D: usize>(tensor: Tensor<D>, what: &'static str) -> Result<Vec<f32>, InferError> {
    tensor.try_into_vec_as::<f32>().map_err(InferError::readback(what))
}
