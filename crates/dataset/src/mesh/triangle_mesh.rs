//! The mesh itself.

use std::sync::Arc;

/// Triangle mesh. All per-vertex lists are either empty or as long as `vertices`.
#[derive(Clone, Debug, Default)]
pub struct TriangleMesh {
    /// Metres, object frame.
    pub vertices: Vec<[f32; 3]>,
    /// Vertex indices of the triangles, anticlockwise seen from outside where the surface is oriented.
    pub faces: Vec<[u32; 3]>,
    /// Unit normals per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates per vertex, origin at the bottom left.
    pub uvs: Vec<[f32; 2]>,
    /// sRGB per vertex.
    pub colors: Vec<[u8; 3]>,
    /// Picture of the texture coordinates, sRGB.
    pub texture: Option<Arc<image::RgbImage>>,
}
