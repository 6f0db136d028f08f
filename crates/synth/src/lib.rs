//! Synthetic RGB-D data: procedural objects, dropped in clutter, rendered, measured by a noisy sensor.
//!
//! [`generate`] fills a folder with MegaPose-style shards. Every shard is a function of (configuration, shard number)
//! alone: random numbers come from per-item streams, so neither threads nor interruptions change a byte.

mod background;
mod bop_lists;
mod bop_set;
mod check;
mod collision;
mod color_camera;
mod contact_sheet;
mod error;
mod folder;
mod generate;
mod mesh_folder;
mod models;
mod noise;
mod object;
mod object_cache;
mod photographs;
mod physics;
mod place;
mod progress;
mod random;
mod scene;
mod sensor;
mod shapes;
mod shard;
mod texture;

pub use bop_set::generate_bop;
pub use check::{CheckReport, Finding, Histogram, PartReport, Statistics, check_dataset};
pub use contact_sheet::contact_sheet;
pub use error::SynthError;
pub use folder::remove_generated;
pub use generate::{generate, generate_shards};
pub use progress::{GenerationProgress, GenerationSummary, Stage};

#[cfg(test)]
mod tests;
