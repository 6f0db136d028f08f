//! PLY meshes as BOP writes them: normals, vertex colours, texture coordinates per vertex or per face corner,
//! and the picture named by a `TextureFile` comment.

use std::{
    collections::HashMap,
    io::{BufReader, Write},
    path::Path,
    sync::Arc,
};

use ply_rs_bw::{
    parser::{Parser, Reader},
    ply::{
        Addable, DefaultElement, ElementDef, Encoding, Header, Property, PropertyAccess,
        PropertyAccessResult, PropertyDef, PropertyType, ScalarType,
    },
    writer::Writer,
};

use super::{MeshError, TriangleMesh};

/// One vertex of the file, in its units.
#[derive(Clone, Copy, Debug, Default)]
struct VertexRecord {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
    color: [u8; 3],
}

/// One polygon of the file.
#[derive(Clone, Debug, Default)]
struct FaceRecord {
    /// `None` when an index is negative.
    corners: Option<Vec<u32>>,
    /// u, v of every corner, or empty.
    corner_uvs: Vec<f32>,
}

const POSITION: [&str; 3] = ["x", "y", "z"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const UV: [&str; 2] = ["texture_u", "texture_v"];
const COLOR: [&str; 3] = ["red", "green", "blue"];
/// Names other programs give the texture coordinates.
const UV_ALIASES: [[&str; 2]; 3] = [["s", "t"], ["u", "v"], ["texcoord_u", "texcoord_v"]];

impl PropertyAccess for VertexRecord {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let index = |names: &[&str]| names.iter().position(|&n| n == name);
        if let Some(i) = index(&COLOR) {
            let Some(value) = property.to_u8_color_lossy() else {
                return PropertyAccessResult::UnsupportedType;
            };
            self.color[i] = value;
            return PropertyAccessResult::Set;
        }
        let uv_index = || UV_ALIASES.iter().find_map(|names| index(names)).or(index(&UV));
        let slot = match (index(&POSITION), index(&NORMAL), uv_index()) {
            (Some(i), _, _) => &mut self.position[i],
            (_, Some(i), _) => &mut self.normal[i],
            (_, _, Some(i)) => &mut self.uv[i],
            _ => return PropertyAccessResult::Ignored,
        };
        let Some(value) = property.to_f32_lossy() else { return PropertyAccessResult::UnsupportedType };
        *slot = value;
        PropertyAccessResult::Set
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let value = |names: &[&str], values: &[f32]| Some(values[names.iter().position(|&n| n == name)?]);
        value(&POSITION, &self.position)
            .or_else(|| value(&NORMAL, &self.normal))
            .or_else(|| value(&UV, &self.uv))
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        Some(self.color[COLOR.iter().position(|&n| n == name)?])
    }
}

impl PropertyAccess for FaceRecord {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (name, property) {
            ("vertex_indices" | "vertex_index", property) => self.corners = property.to_u32_list(),
            ("texcoord", Property::ListFloat(uvs)) => self.corner_uvs = uvs,
            ("texcoord", Property::ListDouble(uvs)) => {
                self.corner_uvs = uvs.iter().map(|&v| v as f32).collect()
            }
            ("texcoord", _) => return PropertyAccessResult::UnsupportedType,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    fn get_list_uint(&self, _name: &str) -> Option<&[u32]> {
        self.corners.as_deref()
    }
}

/// Reads a mesh in the units of the file; polygons become triangle fans.
pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let file = unopose_core::files::open_regular(path).map_err(|e| MeshError::read(path, e))?;
    let mut reader = Reader::new(BufReader::new(file));
    let header =
        Parser::<VertexRecord>::new().read_header(&mut reader).map_err(|e| MeshError::read(path, e))?;
    let mut vertices: Vec<VertexRecord> = Vec::new();
    let mut faces: Vec<FaceRecord> = Vec::new();
    for element in header.elements.values() {
        let result = match element.name.as_str() {
            "vertex" => Parser::new()
                .read_payload_for_element(&mut reader, element, &header)
                .map(|records| vertices = records),
            "face" => Parser::new()
                .read_payload_for_element(&mut reader, element, &header)
                .map(|records| faces = records),
            _ => Parser::<DefaultElement>::new()
                .read_payload_for_element(&mut reader, element, &header)
                .map(|_| ()),
        };
        result.map_err(|e| MeshError::read(path, format!("element {}: {e}", element.name)))?;
    }
    let has = |names: &[&str]| {
        header.elements.get("vertex").is_some_and(|v| names.iter().all(|&n| v.properties.contains_key(n)))
    };
    if !has(&POSITION) {
        return Err(MeshError::read(path, "element vertex has no properties x, y, z"));
    }
    let mut mesh =
        TriangleMesh { vertices: vertices.iter().map(|v| v.position).collect(), ..Default::default() };
    if has(&NORMAL) {
        mesh.normals = vertices.iter().map(|v| v.normal).collect();
    }
    if has(&COLOR) {
        mesh.colors = vertices.iter().map(|v| v.color).collect();
    }
    if has(&UV) || UV_ALIASES.iter().any(|names| has(names)) {
        mesh.uvs = vertices.iter().map(|v| v.uv).collect();
    }
    add_faces(&mut mesh, &faces).map_err(|reason| MeshError::read(path, reason))?;
    let texture = header.comments.iter().find_map(|c| c.trim().strip_prefix("TextureFile"));
    mesh.texture = texture.and_then(|name| read_texture(path, name.trim()));
    Ok(mesh)
}

/// Fans of triangles; vertices whose corners have different texture coordinates are split.
fn add_faces(mesh: &mut TriangleMesh, faces: &[FaceRecord]) -> Result<(), String> {
    let vertex_count = mesh.vertices.len();
    let with_corner_uvs = mesh.uvs.is_empty() && faces.iter().any(|f| !f.corner_uvs.is_empty());
    if with_corner_uvs {
        mesh.uvs = vec![[f32::NAN; 2]; vertex_count];
    }
    let mut split: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
    for (number, face) in faces.iter().enumerate() {
        let Some(mut corners) = face.corners.clone() else {
            return Err(format!("face {number}: vertex_indices missing, negative or not integers"));
        };
        if let Some(&vertex) = corners.iter().find(|&&c| c as usize >= vertex_count) {
            return Err(format!(
                "face {number} refers to vertex {vertex}, but there are only {vertex_count}"
            ));
        }
        if with_corner_uvs {
            if face.corner_uvs.len() != 2 * corners.len() {
                let (met, expected) = (face.corner_uvs.len(), 2 * corners.len());
                return Err(format!("face {number}: texcoord has {met} numbers, expected {expected}"));
            }
            for (corner, uv) in corners.iter_mut().zip(face.corner_uvs.chunks_exact(2)) {
                *corner = corner_vertex(mesh, &mut split, *corner, [uv[0], uv[1]]);
            }
        }
        mesh.faces.extend((2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]));
    }
    for uv in mesh.uvs.iter_mut().filter(|uv| uv[0].is_nan()) {
        *uv = [0.0; 2];
    }
    Ok(())
}

/// The vertex like `vertex` whose texture coordinate is `uv`, made when there is none yet.
fn corner_vertex(
    mesh: &mut TriangleMesh,
    split: &mut HashMap<(u32, [u32; 2]), u32>,
    vertex: u32,
    uv: [f32; 2],
) -> u32 {
    *split.entry((vertex, uv.map(f32::to_bits))).or_insert_with(|| {
        let v = vertex as usize;
        if mesh.uvs[v][0].is_nan() {
            mesh.uvs[v] = uv;
            return vertex;
        }
        mesh.vertices.push(mesh.vertices[v]);
        mesh.uvs.push(uv);
        if !mesh.normals.is_empty() {
            mesh.normals.push(mesh.normals[v]);
        }
        if !mesh.colors.is_empty() {
            mesh.colors.push(mesh.colors[v]);
        }
        (mesh.vertices.len() - 1) as u32
    })
}

/// The texture beside the mesh; `None` with a warning when it cannot be read.
fn read_texture(mesh: &Path, name: &str) -> Option<Arc<image::RgbImage>> {
    let path = mesh.with_file_name(name);
    match image::open(&path) {
        Ok(picture) => Some(Arc::new(picture.to_rgb8())),
        Err(error) => {
            tracing::warn!("{}: {error}; loaded without texture", path.display());
            None
        }
    }
}

/// Writes a binary PLY with everything the mesh has but the texture's pixels; coordinates are multiplied by
/// `scale_from_metres` (1000 for BOP), `texture_file` is named in the header.
pub fn write(
    mesh: &TriangleMesh,
    scale_from_metres: f32,
    texture_file: Option<&str>,
    out: &mut impl Write,
) -> std::io::Result<()> {
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.comments.extend(texture_file.map(|name| format!("TextureFile {name}")));
    let per_vertex = |len: usize| len > 0 && len == mesh.vertices.len();
    let (normals, uvs, colors) =
        (per_vertex(mesh.normals.len()), per_vertex(mesh.uvs.len()), per_vertex(mesh.colors.len()));
    let mut vertex = element("vertex", mesh.vertices.len());
    let groups: [(&[&str], bool, ScalarType); 4] = [
        (&POSITION, true, ScalarType::Float),
        (&NORMAL, normals, ScalarType::Float),
        (&UV, uvs, ScalarType::Float),
        (&COLOR, colors, ScalarType::UChar),
    ];
    for (names, _, scalar) in groups.iter().filter(|(_, present, _)| *present) {
        for &name in *names {
            vertex.properties.add(PropertyDef::new(name.to_owned(), PropertyType::Scalar(scalar.clone())));
        }
    }
    let mut face = element("face", mesh.faces.len());
    let list = PropertyType::List(ScalarType::UChar, ScalarType::UInt);
    face.properties.add(PropertyDef::new("vertex_indices".to_owned(), list));

    let vertices: Vec<_> = (0..mesh.vertices.len())
        .map(|i| VertexRecord {
            position: mesh.vertices[i].map(|x| x * scale_from_metres),
            normal: if normals { mesh.normals[i] } else { [0.0; 3] },
            uv: if uvs { mesh.uvs[i] } else { [0.0; 2] },
            color: if colors { mesh.colors[i] } else { [0; 3] },
        })
        .collect();
    let faces: Vec<_> =
        mesh.faces.iter().map(|f| FaceRecord { corners: Some(f.to_vec()), corner_uvs: Vec::new() }).collect();
    header.elements.add(vertex);
    header.elements.add(face);
    Writer::<VertexRecord>::new().write_header(out, &header)?;
    for element in header.elements.values() {
        if element.name == "vertex" {
            Writer::new().write_payload_of_element(out, &vertices, element, &header)?;
        } else {
            Writer::new().write_payload_of_element(out, &faces, element, &header)?;
        }
    }
    Ok(())
}

fn element(name: &str, count: usize) -> ElementDef {
    let mut element = ElementDef::new(name.to_owned());
    element.count = count;
    element
}

#[cfg(test)]
#[path = "ply_tests.rs"]
mod tests;
