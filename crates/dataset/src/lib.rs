//! Meshes, rendering, dataset files (BOP, MegaPose) and the one-reference protocols. No tensors.

pub mod formats;
pub mod mesh;
pub mod protocol;
pub mod render;
