//! What every part of unopose builds on: configuration, geometry on plain slices, RGB-D views in memory, vector arithmetic
//! and files that are whole or absent. No tensors, no dataset formats.

pub mod config;
pub mod files;
pub mod folder_lock;
pub mod frame;
pub mod geometry;
pub mod interrupt;
mod message;
pub mod simd;

pub use message::explain;
