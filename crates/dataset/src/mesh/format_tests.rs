//! Tiny files of every format.

use super::{
    test_files::{Folder, glb},
    *,
};

/// Colour of the texture in the middle of a face.
fn painted(mesh: &TriangleMesh, face: usize) -> [u8; 3] {
    let picture = mesh.texture.as_ref().unwrap();
    let corners = mesh.faces[face].map(|v| mesh.uvs[v as usize]);
    let middle = [0, 1].map(|axis| corners.iter().map(|uv| uv[axis]).sum::<f32>() / 3.0);
    let (x, y) = (middle[0] * picture.width() as f32, (1.0 - middle[1]) * picture.height() as f32);
    picture.get_pixel(x as u32, y as u32).0
}

const QUADS: &str = "mtllib m.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nv 3 0 0\nv 3 1 0
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl red\nf 1/1 2/2 3/3 4/4
usemtl green\nf 2/1 5/2 6/3 3/4
usemtl blue\nf 5/1 7/2 8/3 6/4\n";

#[test]
fn several_materials_of_an_obj_become_one_picture() {
    let folder = Folder::new();
    let obj = folder.write("a.obj", QUADS);
    folder.write("m.mtl", "newmtl red\nmap_Kd r.png\nnewmtl green\nmap_Kd g.png\nnewmtl blue\nKd 0 0 1\n");
    folder.picture("r.png", [250, 10, 10]);
    folder.picture("g.png", [10, 250, 10]);
    let mesh = load(&obj, 1.0).unwrap();
    assert_eq!((mesh.faces.len(), mesh.vertices.len(), mesh.uvs.len()), (6, 18, 18));
    let colors: Vec<[u8; 3]> = (0..6).map(|f| painted(&mesh, f)).collect();
    assert_eq!(
        colors,
        [[250, 10, 10], [250, 10, 10], [10, 250, 10], [10, 250, 10], [0, 0, 255], [0, 0, 255]]
    );
    assert!((mesh.area() - 3.0).abs() < 1e-6);
}

#[test]
fn a_missing_texture_or_material_file_leaves_the_shape() {
    let folder = Folder::new();
    let obj = folder.write("a.obj", QUADS);
    let bare = load(&obj, 1.0).unwrap();
    assert!(bare.texture.is_none() && bare.faces.len() == 6);
    folder.write("m.mtl", "newmtl red\nKd 1 0 0\nmap_Kd gone.png\nnewmtl green\nnewmtl blue\nKd 0 0 1\n");
    let mesh = load(&obj, 1.0).unwrap();
    assert!(mesh.texture.is_none());
    assert_eq!(mesh.colors[mesh.faces[0][0] as usize], [255, 0, 0]);
    assert_eq!(mesh.colors[mesh.faces[5][0] as usize], [0, 0, 255]);
}

#[test]
fn a_texture_is_found_where_google_scanned_objects_have_it() {
    let folder = Folder::new();
    let obj = folder.write(
        "Cup/meshes/model.obj",
        "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0
vt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n",
    );
    folder.write("Cup/meshes/model.mtl", "newmtl a\nmap_Kd texture.png\n");
    std::fs::create_dir_all(folder.0.path().join("Cup/materials/textures")).unwrap();
    folder.picture("Cup/materials/textures/texture.png", [1, 2, 3]);
    assert_eq!(painted(&load(&obj, 1.0).unwrap(), 0), [1, 2, 3]);
}

#[test]
fn a_glb_is_placed_by_its_nodes_and_coloured_by_its_material() {
    let mut buffer: Vec<u8> = Vec::new();
    for x in [0f32, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 0.0] {
        buffer.extend(x.to_le_bytes());
    }
    buffer.extend([0u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"mesh":0,"translation":[0,0,5],"scale":[2,2,2]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1,"material":0}]}],
        "materials":[{"pbrMetallicRoughness":{"baseColorFactor":[1,0,0,1]}}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[2,2,0]},
            {"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],
        "buffers":[{"byteLength":44}]}"#;
    let glb = glb(json, &buffer);
    let folder = Folder::new();
    let mesh = load(&folder.write("t.glb", &glb), 0.5).unwrap();
    assert_eq!(mesh.vertices, [[0.0, 0.0, 2.5], [2.0, 0.0, 2.5], [0.0, 2.0, 2.5]]);
    assert_eq!(mesh.colors, [[255, 0, 0]; 3]);
    let cut = load(&folder.write("cut.glb", &glb[..glb.len() - 20]), 1.0);
    assert!(cut.unwrap_err().to_string().contains("cut.glb"));
}

#[test]
fn an_stl_tetrahedron_is_closed() {
    let corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
    let mut text = String::from("solid t\n");
    for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in face.map(|i: usize| corners[i]) {
            text += &format!("vertex {x} {y} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    text += "endsolid t\n";
    let folder = Folder::new();
    let mesh = load(&folder.write("t.stl", &text), 1.0).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.open_edges()), (4, 0));
    assert!((mesh.volume() - 1.0 / 6.0).abs() < 1e-7);
    for (name, text) in [("empty.stl", ""), ("empty.obj", ""), ("empty.ply", ""), ("empty.glb", "")] {
        let message = load(&folder.write(name, text), 1.0).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}
