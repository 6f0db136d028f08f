//! Targets of the losses from the true pose. No gradients.

use burn::tensor::{Int, Tensor};

use crate::model::PoseTensors;

/// Correspondence targets of one pair of clouds (one stage).
pub struct MatchLabels {
    /// Distances between the query in the reference frame and the reference, `[B, N, M]`, radii.
    pub distances: Tensor<3>,
    /// Column of each query point's nearest reference point + 1, or 0 = background, `[B, N]`.
    pub query: Tensor<2, Int>,
    /// Row of each reference point's nearest query point + 1, or 0 = background, `[B, M]`.
    pub reference: Tensor<2, Int>,
    /// 1 where the other cloud has a point within the overlap distance, query then reference: `[B, N + M]`.
    pub overlap: Tensor<2>,
}

impl MatchLabels {
    /// Query `[B, N, 3]`, reference `[B, M, 3]`, pose in the same units.
    pub fn new(
        query: Tensor<3>,
        reference: Tensor<3>,
        pose: &PoseTensors,
        match_distance: f32,
        overlap_distance: f32,
    ) -> Self {
        let moved = rotated(query - pose.translation.clone(), pose.rotation.clone()); // rows: R^T (q - t)
        let distances = pairwise_distance(moved, reference);
        let nearest = |dim: usize| {
            let (distance, index) = distances.clone().min_dim_with_indices(dim);
            let far = distance.clone().greater_scalar(match_distance);
            let label = (index + 1).mask_fill(far, 0);
            let overlap = distance.lower_equal_scalar(overlap_distance).float();
            let count = label.shape().num_elements() / label.dims()[0];
            let shape = [label.dims()[0], count];
            (label.reshape(shape), overlap.reshape(shape))
        };
        let (query, query_overlap) = nearest(2);
        let (reference, reference_overlap) = nearest(1);
        Self { query, reference, overlap: Tensor::cat(vec![query_overlap, reference_overlap], 1), distances }
    }
}

/// `[B, N, 3]` and `[B, M, 3]` to `[B, N, M]`. Differences per axis instead of `x^2 - 2 x y + y^2`: a product of points
/// several radii from the origin would leave no digit of a small distance where GPUs round its factors to 11 bits.
pub fn pairwise_distance(a: Tensor<3>, b: Tensor<3>) -> Tensor<3> {
    let b = b.swap_dims(1, 2); // [B, 3, M]
    let [x, y, z] =
        [0, 1, 2].map(|axis| (a.clone().narrow(2, axis, 1) - b.clone().narrow(1, axis, 1)).square());
    (x + y + z).sqrt()
}

/// `[B, N, 3]` times `[B, 3, 3]`, without a matrix product for the same reason.
fn rotated(points: Tensor<3>, rotation: Tensor<3>) -> Tensor<3> {
    let [x, y, z] =
        [0, 1, 2].map(|axis| points.clone().narrow(2, axis, 1) * rotation.clone().narrow(1, axis, 1));
    x + y + z
}
