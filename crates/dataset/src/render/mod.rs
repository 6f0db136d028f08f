//! Rendering: a colour rasteriser with soft shadows for synthetic images.
//!
//! [`SceneRenderer`] prepares what all views of a scene share (shadow maps) and then renders views: linear radiance from
//! several samples per pixel, exact depth and instance ids from one sample at each pixel centre. Rasterising beats
//! casting the primary and shadow rays through a BVH several times over at these sizes; an independent ray query checks
//! it in the tests.

mod buffer;
mod camera;
mod color;
pub mod depth;
mod indirect;
mod instances;
mod lighting;
mod posed;
mod raster;
mod rays;
mod room;
mod scene;
mod shading;
mod shadow;
mod surfel;
mod texture;
mod view;

pub use camera::Camera;
pub use instances::{InstanceView, instance_views};
pub use posed::{PosedView, posed_view};
pub use scene::{Block, Finish, Light, PosedMesh, Room, Scene, Surface};
pub use texture::linear_to_srgb;
pub use view::{Rendering, SceneRenderer};
