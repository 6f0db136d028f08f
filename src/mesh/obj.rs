//! Wavefront OBJ with one diffuse texture.

use std::{path::Path, sync::Arc};

use super::{MeshError, TriangleMesh};

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj(path, &options).map_err(|e| MeshError::read(path, e))?;
    let mut mesh = TriangleMesh::default();
    let with_uv = models.iter().all(|m| m.mesh.texcoords.len() * 3 == m.mesh.positions.len() * 2);
    let with_normals = models.iter().all(|m| m.mesh.normals.len() == m.mesh.positions.len());
    for model in &models {
        let part = &model.mesh;
        let offset = mesh.vertices.len() as u32;
        mesh.vertices.extend(part.positions.chunks_exact(3).map(|p| [p[0], p[1], p[2]]));
        mesh.faces
            .extend(part.indices.chunks_exact(3).map(|f| [f[0] + offset, f[1] + offset, f[2] + offset]));
        if with_uv {
            mesh.uvs.extend(part.texcoords.chunks_exact(2).map(|t| [t[0], t[1]]));
        }
        if with_normals {
            mesh.normals.extend(part.normals.chunks_exact(3).map(|n| [n[0], n[1], n[2]]));
        }
    }
    let materials = match materials {
        Ok(materials) => materials,
        Err(error) => {
            tracing::warn!("{}: material library: {error}; loaded without texture", path.display());
            Vec::new()
        }
    };
    let used = |id: &Option<usize>| id.and_then(|i| materials.get(i));
    let textured = models.iter().filter_map(|m| used(&m.mesh.material_id)?.diffuse_texture.as_ref()).next();
    if let Some(name) = textured {
        mesh.texture = texture_beside(path, name);
    }
    if mesh.texture.is_none() && !materials.is_empty() {
        for model in &models {
            let diffuse = used(&model.mesh.material_id).and_then(|m| m.diffuse).unwrap_or([0.7; 3]);
            let color = diffuse.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
            mesh.colors.extend(std::iter::repeat_n(color, model.mesh.positions.len() / 3));
        }
    }
    Ok(mesh)
}

/// A texture named in a material file; `None` with a warning when it cannot be read.
fn texture_beside(mesh: &Path, name: &str) -> Option<Arc<image::RgbImage>> {
    let folder = mesh.parent().unwrap_or(Path::new("."));
    let name = name.trim().replace('\\', "/");
    // Google Scanned Objects keep the picture in materials/textures beside the meshes folder.
    let candidates =
        [folder.join(&name), folder.join("../materials/textures").join(&name), folder.join("texture.png")];
    let found = candidates.iter().find(|p| p.is_file());
    match found.map(|p| (p, image::open(p))) {
        Some((_, Ok(picture))) => return Some(Arc::new(picture.to_rgb8())),
        Some((p, Err(error))) => tracing::warn!("{}: {error}; loaded without texture", p.display()),
        None => tracing::warn!("{}: texture {name:?} not found; loaded without texture", mesh.display()),
    }
    None
}
