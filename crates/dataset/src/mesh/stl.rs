//! STL, binary or ASCII.

use std::{io::Cursor, path::Path};

use super::{
    MeshError, TriangleMesh,
    file::{decode, read_regular},
};

/// Bytes before the triangles of a binary file: a text and their number.
const HEADER: usize = 84;
/// Bytes of the text.
const TEXT: usize = 80;
/// Bytes of a triangle: normal, corners, attribute.
const TRIANGLE: usize = 50;

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    read_regular(path).and_then(parse).map_err(|reason| MeshError::read(path, reason))
}

fn parse(mut bytes: Vec<u8>) -> Result<TriangleMesh, String> {
    let count = bytes.get(TEXT..HEADER).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let length = count.map(|count| HEADER as u64 + u64::from(count) * TRIANGLE as u64);
    let length_fits = length == Some(bytes.len() as u64);
    // Some programs begin the text of a binary file with "solid".
    if bytes.starts_with(b"solid") && !length_fits {
        bytes = ascii_lines(&bytes);
    } else {
        let Some((count, length)) = count.zip(length) else {
            return Err(format!("{} bytes, expected at least {HEADER} of a binary STL", bytes.len()));
        };
        if length > bytes.len() as u64 {
            let has = bytes.len();
            return Err(format!(
                "the header says {count} triangles, which are {length} bytes; the file has {has}"
            ));
        }
        bytes[..TEXT].fill(0);
    }
    let stl = stl_io::read_stl(&mut Cursor::new(bytes)).map_err(|e| format!("STL: {e}"))?;
    Ok(TriangleMesh {
        vertices: stl.vertices.iter().map(|v| [v[0], v[1], v[2]]).collect(),
        faces: stl.faces.iter().map(|f| f.vertices.map(|i| i as u32)).collect(),
        ..Default::default()
    })
}

/// The text with its name left out, which may be in any encoding.
fn ascii_lines(bytes: &[u8]) -> Vec<u8> {
    let mut text = b"solid mesh".to_vec();
    for line in bytes.split(|&b| b == b'\n').skip(1) {
        text.push(b'\n');
        text.extend(decode(line).as_bytes());
    }
    text
}
