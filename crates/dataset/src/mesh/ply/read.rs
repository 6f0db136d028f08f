//! Reading.

use std::{io::BufRead, path::Path};

use ply_rs_bw::{
    parser::{ParseError, Parser, Reader},
    ply::{DefaultElement, ElementDef, Encoding, Header, PropertyAccess, PropertyType, ScalarType},
};

use super::{
    super::{
        MeshError, TriangleMesh,
        file::{decode, read_regular},
        picture::Pictures,
    },
    faces::Faces,
    records::{COLOR, COLOR_ALIASES, NORMAL, POSITION, UV, UV_ALIASES, VertexRecord},
};

/// Reads a mesh in the units of the file; polygons become triangle fans.
pub(in super::super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    read_regular(path).and_then(|bytes| parse(path, &bytes)).map_err(|reason| MeshError::read(path, reason))
}

fn parse(path: &Path, bytes: &[u8]) -> Result<TriangleMesh, String> {
    let (text, mut payload) = split_header(bytes);
    let header = Parser::<VertexRecord>::new().read_header(&mut Reader::new(text.as_bytes()));
    let header = header.map_err(|e| e.to_string())?;
    let has = |element: &str, names: &[&str]| {
        header.elements.get(element).is_some_and(|v| names.iter().all(|&n| v.properties.contains_key(n)))
    };
    if !has("vertex", &POSITION) {
        return Err("element vertex has no properties x, y, z".to_owned());
    }
    let with_normals = has("vertex", &NORMAL);
    let with_uvs = has("vertex", &UV) || UV_ALIASES.iter().any(|names| has("vertex", names));
    let colored = |element| has(element, &COLOR) || COLOR_ALIASES.iter().any(|names| has(element, names));
    let (colored_vertices, colored_faces) = (colored("vertex"), colored("face"));
    let mut mesh = TriangleMesh::default();
    let mut faces = Faces::default();
    for element in header.elements.values() {
        check_size(element, header.encoding, payload.len())?;
        match element.name.as_str() {
            "vertex" => each(&mut payload, element, &header, |vertex: VertexRecord| {
                mesh.vertices.push(vertex.position);
                mesh.normals.extend(with_normals.then_some(vertex.normal));
                mesh.uvs.extend(with_uvs.then_some(vertex.uv));
                mesh.colors.extend(colored_vertices.then_some(vertex.color));
                Ok(())
            })?,
            "face" => each(&mut payload, element, &header, |face| faces.push(&face, colored_faces))?,
            _ => each(&mut payload, element, &header, |_: DefaultElement| Ok(()))?,
        }
    }
    if colored_vertices && faces.are_colored() {
        tracing::warn!("{}: face colours beside vertex colours are not used", path.display());
    }
    faces.add_to(&mut mesh)?;
    let mut textures = header.comments.iter().filter_map(|c| c.trim().strip_prefix("TextureFile"));
    let texture = textures.next().map(|name| path.with_file_name(name.trim()));
    mesh.texture = texture.and_then(|file| Pictures::of(path).open(&file));
    if textures.next().is_some() {
        tracing::warn!("{}: only the first texture of several is used", path.display());
    }
    Ok(mesh)
}

/// The header as text, and what follows it.
fn split_header(bytes: &[u8]) -> (String, &[u8]) {
    let mut rest = bytes;
    let mut text = String::new();
    while !rest.is_empty() {
        let end = rest.iter().position(|&b| b == b'\n').map_or(rest.len(), |i| i + 1);
        let (line, after) = rest.split_at(end);
        let line = decode(line);
        text.push_str(&line);
        rest = after;
        if line.trim() == "end_header" {
            break;
        }
    }
    (text, rest)
}

/// Refuses more entries than the file can hold.
fn check_size(element: &ElementDef, encoding: Encoding, left: usize) -> Result<(), String> {
    let (name, count) = (&element.name, element.count);
    let size = |scalar: &ScalarType| match scalar {
        // A digit and what separates it from the next number.
        _ if encoding == Encoding::Ascii => 2,
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let smallest: usize = element
        .properties
        .values()
        .map(|property| match &property.data_type {
            PropertyType::Scalar(scalar) | PropertyType::List(scalar, _) => size(scalar),
        })
        .sum();
    if count > 0 && smallest == 0 {
        return Err(format!("element {name} has {count} entries without any property"));
    }
    // The last line of a text may lack its end.
    if count > 0 && count > (left + 1) / smallest {
        return Err(format!(
            "element {name} has {count} entries of at least {smallest} bytes, but only {left} bytes follow"
        ));
    }
    Ok(())
}

fn each<E: PropertyAccess>(
    payload: &mut &[u8],
    element: &ElementDef,
    header: &Header,
    mut take: impl FnMut(E) -> Result<(), String>,
) -> Result<(), String> {
    let parser = Parser::<E>::new();
    for number in 0..element.count {
        let failed = |reason: String| format!("{} {number}: {reason}", element.name);
        let entry = match header.encoding {
            Encoding::Ascii => {
                let mut line = Vec::new();
                payload.read_until(b'\n', &mut line).map_err(|e| failed(e.to_string()))?;
                if line.is_empty() {
                    return Err(failed(format!("the file ends, expected {} entries", element.count)));
                }
                parser.read_ascii_element(&decode(&line), element)
            }
            Encoding::BinaryBigEndian => parser.read_big_endian_element(payload, element),
            Encoding::BinaryLittleEndian => parser.read_little_endian_element(payload, element),
        };
        let reason = |e: ParseError| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => format!("the file ends, expected {} entries", element.count),
            _ => e.to_string(),
        };
        take(entry.map_err(|e| failed(reason(e)))?).map_err(failed)?;
    }
    Ok(())
}
