//! Whole images as the proposal network takes them (`docs/network.md`, section 13): the grid of inputs, what it is to learn of
//! an annotated image, the stream of training images, and instances from what the network answers.

mod input;
mod instances;
mod sampler;
mod support;
mod target;

pub use input::{GEOMETRY_CHANNELS, INPUT_CHANNELS, SceneInput};
pub use instances::{ProposalMaps, SceneInstance, scene_instances};
pub use sampler::{SceneSample, SceneSampler};
pub use target::{CLASSES, SceneTarget};
