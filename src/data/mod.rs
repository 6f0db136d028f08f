//! Pairs of views as the network takes them: crops, points, augmentation, training pairs, prefetched batches.
//!
//! Host arrays only. Random numbers come from one stream per item, (seed, index), so any thread prepares the same
//! item.

mod crop;
mod error;
mod pose_noise;
mod prepare;
mod selection;

pub use crop::CropBox;
pub use error::DataError;
pub use pose_noise::{PoseNoise, draw_rotation_std};
pub use prepare::{
    CloudInput, PreparedReference, metric_pose, normalised_pose, positional_groups, prepare_query,
    prepare_reference, query_from_points, reference_from_points,
};
pub use selection::{MAX_RADIUS, MIN_RADIUS};
