//! From a block's similarities and overlaps on the device to assignments on the host.

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::InferError;
use crate::{
    config::OverlapMode,
    geometry::{Assignment, correlation_assignment, match_assignment},
    model::BlockOutput,
};

/// An assignment on the host with the mean overlaps behind it.
#[derive(Clone, Debug)]
pub struct Matched {
    pub assignment: Assignment,
    /// Mean predicted overlap of the query's and the reference's points.
    pub mean_overlap: [f64; 2],
}

/// One assignment per pair of the batch, in the form that `mode` names.
///
/// `split_at_reference` (quirk of the coarse stage): the release looks for the reference's overlaps behind as many
/// entries as the reference has points, although the query's come first. Equal counts hide that; others stop it.
pub fn host_assignments(
    block: &BlockOutput,
    mode: OverlapMode,
    split_at_reference: bool,
) -> Result<Vec<Matched>, InferError> {
    let [batch, rows, columns] = block.similarity.dims();
    if split_at_reference && mode == OverlapMode::Release && rows != columns {
        return Err(InferError::UnequalCounts { query: rows - 1, reference: columns - 1 });
    }
    let similarity = host(block.similarity.clone(), "similarities")?;
    let [query, reference] = block.overlap_probability();
    let (query, reference) = (host(query, "overlaps")?, host(reference, "overlaps")?);
    let matched = (0..batch)
        .into_par_iter()
        .map(|b| {
            let (n, m) = (rows - 1, columns - 1);
            let overlap = [&query[b * n..(b + 1) * n], &reference[b * m..(b + 1) * m]];
            let mean_overlap =
                overlap.map(|o| o.iter().map(|&x| x as f64).sum::<f64>() / o.len().max(1) as f64);
            let similarity = &similarity[b * rows * columns..(b + 1) * rows * columns];
            let assignment = match mode {
                // Without overlap heads all overlaps are 1.
                OverlapMode::Release | OverlapMode::Off => {
                    match_assignment(similarity, overlap[0], overlap[1])
                }
                OverlapMode::Paper => correlation_assignment(similarity, n, m),
            };
            Matched { assignment, mean_overlap }
        })
        .collect();
    Ok(matched)
}

fn host<const D: usize>(tensor: Tensor<D>, what: &'static str) -> Result<Vec<f32>, InferError> {
    tensor.try_into_vec_as::<f32>().map_err(InferError::readback(what))
}
