use std::io::Write;

use super::*;
use crate::mesh::error::InvalidMesh;

fn cube_obj() -> tempfile::NamedTempFile {
    let mut file = tempfile::Builder::new().suffix(".obj").tempfile().unwrap();
    for i in 0..8 {
        writeln!(file, "v {} {} {}", i & 1, (i >> 1) & 1, (i >> 2) & 1).unwrap();
    }
    file.write_all(b"f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n").unwrap();
    file.flush().unwrap();
    file
}

#[test]
fn obj_cube_in_millimetres_has_metric_size() {
    let file = cube_obj();
    let mesh = load(file.path(), 0.001).unwrap();
    assert_eq!(mesh.faces.len(), 12);
    assert!((mesh.diameter() - 0.001 * 3f32.sqrt()).abs() < 1e-8);
    assert!((mesh.area() - 6e-6).abs() < 1e-10);
    assert!((mesh.volume() - 1e-9).abs() < 1e-14, "outward faces give +1 mm^3, got {}", mesh.volume());
    assert_eq!(mesh.open_edges(), 0);
    assert_eq!(mesh.bounds().size(), [0.001; 3]);
}

#[test]
fn crease_keeps_a_cube_flat_and_an_open_face_is_noticed() {
    let file = cube_obj();
    let mut mesh = load(file.path(), 1.0).unwrap();
    let (split, origin) = split_by_crease(&mesh, 40.0, |_| 0);
    assert_eq!((split.vertices.len(), origin.len()), (24, 24));
    for (n, v) in split.normals.iter().zip(&split.vertices) {
        let axis = (0..3).find(|&i| n[i].abs() > 0.999).unwrap();
        assert_eq!(v[axis] > 0.5, n[axis] > 0.0);
    }
    mesh.faces.pop();
    assert_eq!(mesh.open_edges(), 3);
}

#[test]
fn bad_meshes_are_named() {
    let nan = TriangleMesh {
        vertices: vec![[0.0; 3], [1.0, f32::NAN, 0.0], [0.0, 1.0, 0.0]],
        faces: vec![[0, 1, 2]],
        ..Default::default()
    };
    assert!(matches!(nan.validate(), Err(InvalidMesh::NotFinite { index: 1, .. })));
    let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let far = TriangleMesh { vertices, faces: vec![[0, 1, 7]], ..Default::default() };
    assert_eq!(far.validate(), Err(InvalidMesh::FaceIndex { face: 0, vertex: 7, vertices: 3 }));
    assert_eq!(TriangleMesh::default().validate(), Err(InvalidMesh::Empty { vertices: 0, faces: 0 }));
    assert!(load(Path::new("a.xyz"), 1.0).unwrap_err().to_string().contains("expected ply"));
}
