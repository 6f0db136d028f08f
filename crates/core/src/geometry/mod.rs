//! Geometry on plain point slices: cameras, poses, sampling, reference frames, neighbours, registration.
//!
//! Knows no tensors and no files. Clouds are `&[[f32; 3]]`, poses are `f64`. Loops over many points run on rayon;
//! results do not depend on the number of threads.

mod assignment;
mod camera;
mod coarse_pose;
mod columns;
mod correlation;
mod distortion;
mod fine_pose;
mod icosphere;
mod mean_shift;
mod mutual_fit;
mod neighbors;
mod pose;
mod procrustes;
mod reference_frame;
mod sampling;
mod structure;
mod svd;

pub use assignment::{Assignment, match_assignment};
pub use camera::{Intrinsics, IntrinsicsError};
pub use coarse_pose::{CoarsePose, Hypothesis, coarse_pose, match_distribution};
pub use correlation::correlation_assignment;
pub use distortion::Distortion;
pub use fine_pose::{FinePose, fine_pose};
pub use icosphere::icosphere;
pub use mean_shift::{MeanShift, NO_MODE, mean_shift};
pub use mutual_fit::MutualFit;
pub use neighbors::{
    BallGroups, BallQuery, LocalFrames, SignCount, ball_groups, ball_query, local_frames, local_sign_counts,
    nearest_distances, nearest_match,
};
pub use pose::Pose;
pub use procrustes::weighted_procrustes;
pub use reference_frame::{FrameAxes, GlobalReferenceFrame, global_reference_frame};
pub use sampling::{farthest_point_sampling, radius_about_mean};
pub use structure::{StructureIndices, structure_indices};
