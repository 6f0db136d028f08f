use super::{
    super::{MeshError, TriangleMesh},
    *,
};

fn read_text(text: impl AsRef<[u8]>) -> Result<TriangleMesh, MeshError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    std::fs::write(&path, text).unwrap();
    read(&path)
}

fn quad(vertex_properties: &str, lines: [&str; 4], face: &str) -> String {
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
         {vertex_properties}element face 1\nproperty list uchar int vertex_indices\n{face}",
    )
    .replace("BODY", &lines.join("\n"))
}

#[test]
fn polygons_become_fans_and_alpha_is_ignored() {
    let colors = "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n";
    let lines = ["0 0 0 1 2 3 255", "10 0 0 4 5 6 255", "10 10 0 7 8 9 255", "0 10 0 10 11 12 255"];
    let mesh = read_text(quad(colors, lines, "end_header\nBODY\n4 0 1 2 3\n")).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.vertices[2], [10.0, 10.0, 0.0]);
    assert_eq!(mesh.colors[3], [10, 11, 12]);
    assert!(mesh.normals.is_empty() && mesh.uvs.is_empty() && mesh.texture.is_none());
}

#[test]
fn corner_coordinates_split_only_the_vertices_on_a_seam() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n\
                end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0 0 0.5 0.5 0 1\n";
    let mesh = read_text(text).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 4, 3]]);
    assert_eq!(mesh.vertices[4], mesh.vertices[2]);
    assert_eq!((mesh.uvs[2], mesh.uvs[4]), ([1.0, 1.0], [0.5, 0.5]));
}

#[test]
fn what_is_written_is_read_back_scaled() {
    let mesh = TriangleMesh {
        vertices: vec![[0.0, 0.0, 0.25], [0.5, 0.0, 0.0], [0.0, 0.125, 0.0]],
        faces: vec![[0, 1, 2]],
        normals: vec![[0.0, 0.0, 1.0]; 3],
        uvs: vec![[0.0, 0.5], [0.25, 1.0], [0.75, 0.125]],
        colors: vec![[1, 2, 3], [4, 5, 6], [255, 0, 9]],
        texture: None,
    };
    let mut bytes = Vec::new();
    write(&mesh, 1000.0, Some("none.png"), &mut bytes).unwrap();
    let read = read_text(&bytes).unwrap();
    assert_eq!(read.vertices[1], [500.0, 0.0, 0.0]);
    assert_eq!(read.faces, mesh.faces);
    assert_eq!((read.normals, read.uvs, read.colors), (mesh.normals, mesh.uvs, mesh.colors));

    for keep in [0, 3, 40, bytes.len() - 5] {
        let message = read_text(&bytes[..keep]).unwrap_err().to_string();
        assert!(message.contains("mesh.ply"), "{message}");
    }
}

#[test]
fn bad_files_are_named_with_what_is_wrong() {
    let lines = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"];
    for (text, part) in [
        (quad("", lines, "end_header\nBODY\n4 0 1 2 9\n"), "face 0 refers to vertex 9"),
        (quad("", lines, "end_header\nBODY\n3 0 1 -2\n"), "negative"),
        (quad("", lines, "end_header\nBODY\n"), "face"),
        ("solid nothing\n".to_owned(), "mesh.ply"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n".to_owned(), "x, y, z"),
    ] {
        let message = read_text(&text).unwrap_err().to_string();
        assert!(message.contains("mesh.ply") && message.contains(part), "{message}");
    }
}
