//! Wavefront OBJ with its material library.

use std::{collections::HashMap, path::Path, sync::Arc};

use image::RgbImage;

use super::{
    MeshError, TriangleMesh,
    atlas::Material,
    file::read_regular,
    obj_lines::{Lines, ObjCheck, edit_mtl},
    picture::Pictures,
};

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let bytes = read_regular(path).map_err(|reason| MeshError::read(path, reason))?;
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ..Default::default() };
    let mut check = ObjCheck::new(&bytes);
    let mut lines = Lines::new(&bytes, |line, number| check.edit(line, number));
    let load_materials = |name: &Path| read_library(path, name);
    let loaded = tobj::load_obj_buf(&mut lines, &options, load_materials);
    let reason = loaded.as_ref().err().map(|error| lines.explain(error)).unwrap_or_default();
    drop(lines);
    let (models, materials) = loaded.map_err(|error| {
        use tobj::LoadError::{FaceNormalOutOfBounds, FaceTexCoordOutOfBounds, FaceVertexOutOfBounds};
        let ranges = [FaceVertexOutOfBounds, FaceTexCoordOutOfBounds, FaceNormalOutOfBounds];
        let place = ranges.contains(&error).then(|| check.out_of_range()).flatten();
        MeshError::read(path, place.unwrap_or(reason))
    })?;
    let materials = materials.unwrap_or_default();
    let mut mesh = TriangleMesh::default();
    let with_uv = models.iter().any(|m| !m.mesh.texcoords.is_empty());
    let with_normals = models.iter().all(|m| m.mesh.normals.len() == m.mesh.positions.len());
    let surfaces = surfaces_of(path, &materials);
    // Some programs count colours to 255.
    let colors = models.iter().flat_map(|m| &m.mesh.vertex_color);
    let white = if colors.copied().fold(0.0, f32::max) > 2.0 { 255.0 } else { 1.0 };
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
            if part.texcoords.len() / 2 == part.positions.len() / 3 {
                mesh.uvs.extend(part.texcoords.chunks_exact(2).map(|t| [t[0], t[1]]));
            } else if !part.texcoords.is_empty() {
                tracing::warn!(
                    "{}: some corners of {:?} have no texture coordinates; its texture is left out",
                    path.display(),
                    model.name
                );
            }
            mesh.uvs.resize(mesh.vertices.len(), [0.0; 2]);
        }
        if with_normals {
            mesh.normals.extend(part.normals.chunks_exact(3).map(|n| [n[0], n[1], n[2]]));
        }
        if check.colored {
            let plain = surfaces[material].color;
            mesh.colors.extend(part.vertex_color.chunks_exact(3).map(|c| vertex_color(c, white, plain)));
        }
    }
    if !materials.is_empty() {
        mesh.paint(path, &surfaces, &of_face);
    }
    Ok(mesh)
}

/// sRGB of a vertex, given in 0..`white`; `plain` where it has no colour.
fn vertex_color(color: &[f32], white: f32, plain: [u8; 3]) -> [u8; 3] {
    if color.iter().any(|c| c.is_nan()) {
        return plain;
    }
    std::array::from_fn(|i| ((color[i] / white).clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// The materials of a library beside the mesh; none with a warning when it cannot be read.
fn read_library(mesh: &Path, name: &Path) -> tobj::MTLLoadResult {
    let path = mesh.parent().unwrap_or(Path::new("")).join(name);
    let loaded = read_regular(&path).and_then(|bytes| {
        let mut lines = Lines::new(&bytes, |line, _| Ok(edit_mtl(line)));
        tobj::load_mtl_buf(&mut lines).map_err(|e| lines.explain(&e))
    });
    Ok(loaded.unwrap_or_else(|reason| {
        tracing::warn!(
            "{}: material library {}: {reason}; loaded without texture",
            mesh.display(),
            path.display()
        );
        Default::default()
    }))
}

/// The surfaces of a file's materials, and one for faces that have none.
fn surfaces_of(path: &Path, materials: &[tobj::Material]) -> Vec<Material> {
    let mut pictures = Pictures::of(path);
    let mut known: HashMap<&str, Option<Arc<RgbImage>>> = HashMap::new();
    let mut painted: Vec<Material> = materials
        .iter()
        .map(|m| {
            let diffuse = m.diffuse.unwrap_or([0.7; 3]);
            let color = diffuse.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
            let name = m.diffuse_texture.as_deref().filter(|name| !name.trim().is_empty());
            let picture = name.and_then(|name| {
                known.entry(name).or_insert_with(|| texture_beside(path, name, &mut pictures)).clone()
            });
            Material { picture, color }
        })
        .collect();
    painted.push(Material { picture: None, color: [176; 3] });
    painted
}

/// A texture named in a material file; `None` with a warning when it cannot be read.
fn texture_beside(mesh: &Path, name: &str, pictures: &mut Pictures) -> Option<Arc<RgbImage>> {
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
    if found.is_none() {
        tracing::warn!("{}: texture {name:?} not found; loaded without texture", mesh.display());
    }
    pictures.open(found?)
}
