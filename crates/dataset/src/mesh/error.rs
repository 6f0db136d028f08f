//! Errors of mesh files and mesh data.

use std::path::{Path, PathBuf};

/// Why a mesh file could not be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// No reader for files of this name.
    #[error("{}: extension {extension:?}, expected ply, obj, stl, glb or gltf", path.display())]
    Extension {
        /// File of the mesh.
        path: PathBuf,
        /// The extension met, in lower case.
        extension: String,
    },
    /// The file is absent or broken.
    #[error("{}: {reason}", path.display())]
    Read {
        /// File of the mesh.
        path: PathBuf,
        /// Reason of the reader.
        reason: String,
    },
    /// The file was read, but its mesh is not usable.
    #[error("{}: {source}", path.display())]
    Invalid {
        /// File of the mesh.
        path: PathBuf,
        /// What is wrong with the mesh.
        source: InvalidMesh,
    },
}

/// Characters of a reader's reason that are shown.
const LONGEST_REASON: usize = 400;

impl MeshError {
    pub(super) fn read(path: &Path, reason: impl ToString) -> Self {
        // Readers quote the input, of which a line may have megabytes.
        let mut reason = reason.to_string();
        if let Some((end, _)) = reason.char_indices().nth(LONGEST_REASON) {
            reason.truncate(end);
            reason += "...";
        }
        Self::Read { path: path.to_owned(), reason }
    }
}

/// What is wrong with a mesh in memory.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum InvalidMesh {
    /// Too few vertices or faces for a surface.
    #[error("mesh has {vertices} vertices and {faces} faces, expected at least 3 and 1")]
    Empty {
        /// Number of vertices.
        vertices: usize,
        /// Number of faces.
        faces: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {index} is {value:?}, expected finite coordinates")]
    NotFinite {
        /// Index of the vertex.
        index: usize,
        /// Its coordinates.
        value: [f32; 3],
    },
    /// The mesh is too large or too small for any object, mostly because of its unit.
    #[error("mesh extends over {extent:e} m, expected 1e-6 to 1e3 m")]
    Extent {
        /// Longest side of the box around it, metres.
        extent: f32,
    },
    /// A face has a corner that is no vertex.
    #[error("face {face} refers to vertex {vertex}, but there are only {vertices}")]
    FaceIndex {
        /// Index of the face.
        face: usize,
        /// Vertex index that it refers to.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A list per vertex is neither empty nor as long as the vertices.
    #[error("{list} has {len} entries, expected 0 or {vertices}")]
    ListLength {
        /// `normals`, `uvs` or `colors`.
        list: &'static str,
        /// Its length.
        len: usize,
        /// Number of vertices.
        vertices: usize,
    },
    /// No face has an area.
    #[error("all faces have zero area")]
    ZeroArea,
}
