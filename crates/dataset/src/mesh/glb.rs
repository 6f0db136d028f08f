//! glTF 2.0 (binary or with separate buffers): all triangle primitives of the default scene with their base colours.

use std::{path::Path, sync::Arc};

use gltf::image::Format;
use nalgebra::{Matrix4, Point3};

use super::{MeshError, TriangleMesh, atlas::Material};

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let (document, buffers, images) = gltf::import(path).map_err(|e| MeshError::read(path, e))?;
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let scene = scene.ok_or_else(|| MeshError::read(path, "no scene"))?;
    let mut mesh = TriangleMesh::default();
    let mut pending: Vec<(gltf::Node, Matrix4<f32>)> =
        scene.nodes().map(|n| (n, Matrix4::identity())).collect();
    let mut of_face = Vec::new();
    // Primitives without a material get the one after the last.
    let default_material = document.materials().len();
    while let Some((node, parent)) = pending.pop() {
        let local: Matrix4<f32> = node.transform().matrix().into();
        let t_scene_node = parent * local;
        pending.extend(node.children().map(|child| (child, t_scene_node)));
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            if primitive.mode() == gltf::mesh::Mode::Triangles {
                append(&mut mesh, &primitive, &buffers, &t_scene_node, path)?;
                let material = primitive.material().index().unwrap_or(default_material);
                of_face.resize(mesh.faces.len(), material as u32);
            }
        }
    }
    let pictures: Vec<Option<Arc<image::RgbImage>>> =
        images.iter().map(|data| to_rgb(data).map(Arc::new)).collect();
    let mut materials: Vec<Material> = document
        .materials()
        .map(|material| {
            let surface = material.pbr_metallic_roughness();
            let index = surface.base_color_texture().map(|t| t.texture().source().index());
            let picture = index.and_then(|i| pictures.get(i).cloned().flatten());
            if picture.is_none() && index.is_some() {
                tracing::warn!("{}: a texture has an unsupported pixel format; left out", path.display());
            }
            let factor = surface.base_color_factor();
            Material { picture, color: [factor[0], factor[1], factor[2]].map(srgb) }
        })
        .collect();
    materials.push(Material { picture: None, color: [176; 3] });
    mesh.paint(&materials, &of_face);
    Ok(mesh)
}

fn srgb(linear: f32) -> u8 {
    (linear.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8
}

fn append(
    mesh: &mut TriangleMesh,
    primitive: &gltf::Primitive,
    buffers: &[gltf::buffer::Data],
    t_scene_node: &Matrix4<f32>,
    path: &Path,
) -> Result<(), MeshError> {
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| data.0.as_slice()));
    let positions =
        reader.read_positions().ok_or_else(|| MeshError::read(path, "primitive without positions"))?;
    let offset = mesh.vertices.len() as u32;
    mesh.vertices.extend(positions.map(|p| {
        let q = t_scene_node.transform_point(&Point3::from(p));
        [q.x, q.y, q.z]
    }));
    let count = mesh.vertices.len() - offset as usize;
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..count as u32).collect(),
    };
    mesh.faces.extend(indices.chunks_exact(3).map(|f| [f[0] + offset, f[1] + offset, f[2] + offset]));
    // glTF puts the texture origin at the top left.
    match reader.read_tex_coords(0) {
        Some(uvs) => mesh.uvs.extend(uvs.into_f32().map(|[u, v]| [u, 1.0 - v])),
        None => mesh.uvs.extend(std::iter::repeat_n([0.0, 0.0], count)),
    }
    Ok(())
}

fn to_rgb(data: &gltf::image::Data) -> Option<image::RgbImage> {
    let channels = match data.format {
        Format::R8 => 1,
        Format::R8G8 => 2,
        Format::R8G8B8 => 3,
        Format::R8G8B8A8 => 4,
        _ => return None,
    };
    let pixel = |p: &[u8]| if channels < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
    let bytes = data.pixels.chunks_exact(channels).flat_map(pixel).collect();
    image::RgbImage::from_raw(data.width, data.height, bytes)
}
