//! The fused operations as loops over the memory of the `flex` backend. Every function answers `None` for tensors that are
//! not `f32` in that memory, and then the plain form runs.

pub mod attention_layer;
pub mod cosines;
pub mod dense_layer;
pub mod embedding;
pub mod focus;
pub mod in_place;
pub mod linear_relu;
pub mod moments;
pub mod panels;
pub mod pooled;
pub mod relative_scores;
pub mod rows;
pub mod self_attention;
pub mod softmax_attention;
pub mod tape;
pub mod vision_block;

/// Rows per parallel task; fixed, so that sums over rows do not depend on the number of threads.
const BLOCK: usize = 512;
