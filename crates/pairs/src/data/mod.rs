//! Pairs of views as the network takes them: crops, points, augmentation, training pairs, prefetched batches.
//!
//! Host arrays only. Random numbers come from one stream per item, (seed, index), so any thread prepares the same
//! item.

mod augmentation;
mod color;
mod crop;
mod dilation;
mod error;
mod frame_cache;
mod label;
mod pairs;
mod plausible;
mod pose_noise;
mod prepare;
mod scene;
mod selection;
mod stream;

pub use crop::{imagenet_normalised, imagenet_restored};
pub use dilation::dilated;
pub use error::DataError;
pub use label::overlap_share;
pub use pairs::{FrameSource, PairKey, PairSampler, TrainSample};
pub use plausible::{Plausibility, plausibility, scale_correction};
pub use pose_noise::PoseNoise;
pub use prepare::{
    CloudInput, PreparedReference, metric_pose, normalised_pose, positional_groups, prepare_query,
    prepare_reference, query_from_points, reference_from_points,
};
pub use scene::{
    CLASSES, GEOMETRY_CHANNELS, INPUT_CHANNELS, ProposalMaps, SceneInput, SceneInstance, SceneSample,
    SceneSampler, SceneTarget, scene_instances,
};
pub use stream::{BatchStream, SampleSource};
