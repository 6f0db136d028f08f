//! Wavefront OBJ with its material library.

use std::{collections::HashMap, path::Path, sync::Arc};

use image::RgbImage;

use super::{MeshError, TriangleMesh, atlas::Material};

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj(path, &options).map_err(|e| MeshError::read(path, e))?;
    let mut mesh = TriangleMesh::default();
    let with_uv = models.iter().any(|m| !m.mesh.texcoords.is_empty());
    let with_normals = models.iter().all(|m| m.mesh.normals.len() == m.mesh.positions.len());
    let materials = match materials {
        Ok(materials) => materials,
        Err(error) => {
            tracing::warn!("{}: material library: {error}; loaded without texture", path.display());
            Vec::new()
        }
    };
    // Faces without a material get the one after the last.
    let mut of_face = Vec::new();
    for model in &models {
        let part = &model.mesh;
        let offset = mesh.vertices.len() as u32;
        mesh.vertices.extend(part.positions.chunks_exact(3).map(|p| [p[0], p[1], p[2]]));
        mesh.faces
            .extend(part.indices.chunks_exact(3).map(|f| [f[0] + offset, f[1] + offset, f[2] + offset]));
        let material = part.material_id.filter(|&m| m < materials.len()).unwrap_or(materials.len());
        of_face.resize(mesh.faces.len(), material as u32);
        if with_uv {
            mesh.uvs.extend(part.texcoords.chunks_exact(2).map(|t| [t[0], t[1]]));
            mesh.uvs.resize(mesh.vertices.len(), [0.0; 2]);
        }
        if with_normals {
            mesh.normals.extend(part.normals.chunks_exact(3).map(|n| [n[0], n[1], n[2]]));
        }
    }
    if !materials.is_empty() {
        mesh.paint(&load_materials(path, &materials), &of_face);
    }
    Ok(mesh)
}

fn load_materials(path: &Path, materials: &[tobj::Material]) -> Vec<Material> {
    let mut pictures: HashMap<&str, Option<Arc<RgbImage>>> = HashMap::new();
    let mut painted: Vec<Material> = materials
        .iter()
        .map(|m| {
            let diffuse = m.diffuse.unwrap_or([0.7; 3]);
            let color = diffuse.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
            let name = m.diffuse_texture.as_deref().filter(|name| !name.trim().is_empty());
            let picture = name
                .and_then(|name| pictures.entry(name).or_insert_with(|| texture_beside(path, name)).clone());
            Material { picture, color }
        })
        .collect();
    painted.push(Material { picture: None, color: [176; 3] });
    painted
}

/// A texture named in a material file; `None` with a warning when it cannot be read.
fn texture_beside(mesh: &Path, name: &str) -> Option<Arc<RgbImage>> {
    let folder = mesh.parent().unwrap_or(Path::new("."));
    // Options such as "-s 1 1 1" stand before the name.
    let name = name.trim().replace('\\', "/");
    let last = name.rsplit(' ').next().unwrap_or(&name).to_owned();
    // Google Scanned Objects keep the picture in materials/textures beside the meshes folder.
    let candidates = [
        folder.join(&name),
        folder.join(&last),
        folder.join("../materials/textures").join(&name),
        folder.join("texture.png"),
    ];
    let found = candidates.iter().find(|p| p.is_file());
    match found.map(|p| (p, image::open(p))) {
        Some((_, Ok(picture))) => return Some(Arc::new(picture.to_rgb8())),
        Some((p, Err(error))) => tracing::warn!("{}: {error}; loaded without texture", p.display()),
        None => tracing::warn!("{}: texture {name:?} not found; loaded without texture", mesh.display()),
    }
    None
}
