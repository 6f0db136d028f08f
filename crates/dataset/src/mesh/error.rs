//! Errors of mesh files and mesh data.

use std::path::{Path, PathBuf};

/// Why a mesh file could not be used.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    #[error("{}: extension {extension:?}, expected ply, obj, stl, glb or gltf", path.display())]
    Extension { path: PathBuf, extension: String },
    #[error("{}: {reason}", path.display())]
    Read { path: PathBuf, reason: String },
    #[error("{}: {source}", path.display())]
    Invalid { path: PathBuf, source: InvalidMesh },
}

impl MeshError {
    pub(super) fn read(path: &Path, reason: impl ToString) -> Self {
        Self::Read { path: path.to_owned(), reason: reason.to_string() }
    }
}

/// What is wrong with a mesh in memory.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum InvalidMesh {
    #[error("mesh has {vertices} vertices and {faces} faces, expected at least 3 and 1")]
    Empty { vertices: usize, faces: usize },
    #[error("vertex {index} is {value:?}, expected finite coordinates")]
    NotFinite { index: usize, value: [f32; 3] },
    #[error("face {face} refers to vertex {vertex}, but there are only {vertices}")]
    FaceIndex { face: usize, vertex: u32, vertices: usize },
    #[error("{list} has {len} entries, expected 0 or {vertices}")]
    ListLength { list: &'static str, len: usize, vertices: usize },
    #[error("all faces have zero area")]
    Flat,
}
