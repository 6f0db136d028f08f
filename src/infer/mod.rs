//! Inference: from prepared pairs to poses, and the user-facing [`PoseEstimator`].

mod pairs;

pub use pairs::{
    EncodedReferences, PairEstimate, StageTimes, Uniforms, encode_references, estimate_encoded,
    estimate_pairs,
};
