//! Writing.

use std::io::Write;

use ply_rs_bw::{
    ply::{Addable, ElementDef, Encoding, Header, PropertyDef, PropertyType, ScalarType},
    writer::Writer,
};

use super::{
    super::TriangleMesh,
    records::{COLOR, FaceRecord, NORMAL, POSITION, UV, VertexRecord},
};

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
    let faces: Vec<_> = mesh
        .faces
        .iter()
        .map(|f| FaceRecord { corners: Some(f.to_vec()), ..FaceRecord::default() })
        .collect();
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
