//! STL, binary or ASCII.

use std::{io::BufReader, path::Path};

use super::{MeshError, TriangleMesh};

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    let file = unopose_core::files::open_regular(path).map_err(|e| MeshError::read(path, e))?;
    let stl = stl_io::read_stl(&mut BufReader::new(file)).map_err(|e| MeshError::read(path, e))?;
    Ok(TriangleMesh {
        vertices: stl.vertices.iter().map(|v| [v[0], v[1], v[2]]).collect(),
        faces: stl.faces.iter().map(|f| f.vertices.map(|i| i as u32)).collect(),
        ..Default::default()
    })
}
