//! Triangle meshes in metres, with their files (PLY, OBJ, STL, GLB).
//!
//! [`load`] picks the reader by extension and hands out a validated mesh; [`TriangleMesh`] itself is plain data.

mod atlas;
mod error;
mod file;
mod glb;
mod measure;
mod normals;
mod obj;
mod obj_lines;
mod picture;
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
/// Normals missing in the file are computed; a texture that cannot be read is reported in the log and left out. A file
/// that contradicts itself, or a mesh whose size no object has, is an error; memory stays within a small multiple of
/// the file's length and its pictures.
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
    if mesh.uvs.iter().flatten().any(|x| !x.is_finite()) {
        tracing::warn!("{}: texture coordinates that are not finite; taken for 0", path.display());
        mesh.uvs.iter_mut().flatten().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
    }
    let finite_normals = mesh.normals.iter().flatten().all(|x| x.is_finite());
    if mesh.normals.len() != mesh.vertices.len() || !finite_normals {
        mesh.compute_normals();
    }
    Ok(mesh)
}

#[cfg(test)]
mod broken_tests;
#[cfg(test)]
mod color_tests;
#[cfg(test)]
mod format_tests;
#[cfg(test)]
mod mutation_tests;
#[cfg(test)]
mod test_files;
#[cfg(test)]
mod tests;
