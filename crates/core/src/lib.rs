//! What every part of unopose builds on: configuration, geometry on plain slices, RGB-D views in memory, vector arithmetic
//! and files: written whole, read where they have an end. No tensors, no dataset formats.

pub mod config;
pub mod files;
pub mod folder_lock;
pub mod frame;
pub mod geometry;
pub mod interrupt;
mod message;
pub mod simd;

pub use message::explain;
