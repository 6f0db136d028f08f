//! Triangle meshes in metres, with their files (PLY, OBJ, STL, GLB).
//!
//! [`load`] picks the reader by extension and hands out a validated mesh; [`TriangleMesh`] itself is plain data.

mod atlas;
mod error;
mod glb;
mod measure;
mod normals;
mod obj;
pub mod ply;
mod stl;
mod triangle_mesh;

pub use error::{InvalidMesh, MeshError};
pub use measure::Bounds;
pub use normals::split_by_crease;
pub use triangle_mesh::TriangleMesh;

use std::path::Path;

/// Loads a mesh by its extension (ply, obj, stl, glb, gltf) and multiplies coordinates by `scale_to_metres`.
///
/// Normals missing in the file are computed; a missing texture file is reported in the log and left out.
pub fn load(path: &Path, scale_to_metres: f32) -> Result<TriangleMesh, MeshError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let mut mesh = match extension.as_str() {
        "obj" => obj::read(path)?,
        "ply" => ply::read(path)?,
        "stl" => stl::read(path)?,
        "glb" | "gltf" => glb::read(path)?,
        _ => return Err(MeshError::Extension { path: path.to_owned(), extension }),
    };
    mesh.scale(scale_to_metres);
    mesh.validate().map_err(|source| MeshError::Invalid { path: path.to_owned(), source })?;
    mesh.remove_degenerate_faces();
    if mesh.normals.len() != mesh.vertices.len() {
        mesh.compute_normals();
    }
    Ok(mesh)
}

#[cfg(test)]
mod format_tests;
#[cfg(test)]
mod tests;
