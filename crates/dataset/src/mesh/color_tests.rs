//! Colours of vertices and faces, textures that cannot be read, names in any encoding.

use image::ImageFormat;
use serde_json::json;

use super::{
    test_files::{Folder, glb, picture, tetrahedron, textured_tetrahedron},
    *,
};

const TETRAHEDRON: &str = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

#[test]
fn vertex_colors_of_an_obj_are_used() {
    let folder = Folder::new();
    let faces = TETRAHEDRON;
    let fractions =
        format!("v 0 0 0 1 0 0\nv .1 0 0 0 0.5 0\nv 0 .1 0 0 0 1\nv 0 0 .1 1 1 1 # white\n{faces}");
    let bytes = format!("v 0 0 0 255 0 0\nv .1 0 0 0 128 0\nv 0 .1 0 0 0 255\nv 0 0 .1 255 255 255\n{faces}");
    let some = format!("v 0 0 0 1 0 0\nv .1 0 0 0 0.5 0\nv 0 .1 0\nv 0 0 .1\n{faces}");
    let colors = |text: &str| {
        let mesh = load(&folder.write("a.obj", text), 1.0).unwrap();
        // In the order of the file.
        let of = |p: [f32; 3]| mesh.colors[mesh.vertices.iter().position(|v| *v == p).unwrap()];
        [of([0.0; 3]), of([0.1, 0.0, 0.0]), of([0.0, 0.1, 0.0]), of([0.0, 0.0, 0.1])]
    };
    let expected = [[255, 0, 0], [0, 128, 0], [0, 0, 255], [255; 3]];
    assert_eq!(colors(&fractions), expected);
    assert_eq!(colors(&bytes), expected);
    assert_eq!(colors(&some), [[255, 0, 0], [0, 128, 0], [176; 3], [176; 3]]);
}

#[test]
fn face_colors_of_a_ply_split_the_vertices_between_them() {
    let folder = Folder::new();
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element face 2\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n\
                property uchar blue\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n";
    let mesh = load(&folder.write("a.ply", text), 1.0).unwrap();
    let corners =
        |face: usize| mesh.faces[face].map(|v| (mesh.vertices[v as usize], mesh.colors[v as usize]));
    let (red, blue) = ([255, 0, 0], [0, 0, 255]);
    assert_eq!(corners(0), [([0.0, 0.0, 0.0], red), ([1.0, 0.0, 0.0], red), ([1.0, 1.0, 0.0], red)]);
    assert_eq!(corners(1), [([0.0, 0.0, 0.0], blue), ([1.0, 1.0, 0.0], blue), ([0.0, 1.0, 0.0], blue)]);
    assert_eq!(mesh.vertices.len(), 6);
}

#[test]
fn vertex_colors_of_a_glb_multiply_its_base_color() {
    let (mut json, buffer) = tetrahedron();
    let folder = Folder::new();
    let primitive = &mut json["meshes"][0]["primitives"][0];
    primitive["attributes"] = json!({"POSITION": 0, "COLOR_0": 2});
    json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([1, 0.5, 0, 1]);
    let mesh = load(&folder.write("a.glb", glb(&json.to_string(), &buffer)), 1.0).unwrap();
    // 0.5 in linear light.
    assert_eq!(mesh.colors, [[255, 0, 0], [0, 186, 0], [0, 0, 0], [255, 186, 0]]);
    json["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
    let mesh = load(&folder.write("b.glb", glb(&json.to_string(), &buffer)), 1.0).unwrap();
    assert_eq!(mesh.colors, [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255; 3]]);
}

#[test]
fn a_texture_that_cannot_be_read_costs_the_texture() {
    let (json, buffer) = textured_tetrahedron();
    let folder = Folder::new();
    let load_glb = |json: &serde_json::Value, buffer: &[u8]| {
        load(&folder.write("a.glb", glb(&json.to_string(), buffer)), 1.0).unwrap()
    };
    let color = |mesh: &TriangleMesh| mesh.texture.as_ref().map(|t| t.get_pixel(3, 3).0);
    assert_eq!(color(&load_glb(&json, &buffer)), Some([9, 8, 7]));
    for image in [json!({"mimeType": "image/png"}), json!({"uri": "gone.png"}), json!({"uri": "../a.png"})] {
        let mut broken = json.clone();
        broken["images"] = json!([image]);
        let mesh = load_glb(&broken, &buffer);
        assert_eq!((color(&mesh), mesh.faces.len()), (None, 4));
    }
    let mut cut = buffer.clone();
    let start = buffer.windows(4).position(|w| w == b"\x89PNG").unwrap();
    cut[start + 20..start + 40].fill(0);
    assert_eq!(color(&load_glb(&json, &cut)), None);

    let mut webp = json.clone();
    folder.write("a b.webp", picture([5, 6, 7], ImageFormat::WebP));
    webp["images"] = json!([{"uri": "a%20b.webp"}]);
    assert_eq!(color(&load_glb(&webp, &buffer)), Some([5, 6, 7]));
    webp["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 0}}}]);
    webp["extensionsRequired"] = json!(["EXT_texture_webp"]);
    assert_eq!(color(&load_glb(&webp, &buffer)), Some([5, 6, 7]));
}

#[test]
fn names_and_comments_need_not_be_utf8() {
    let folder = Folder::new();
    let latin = |text: &str| text.chars().map(|c| c as u8).collect::<Vec<u8>>();
    let vertices = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\n";
    let corners = "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n";
    let obj = format!("# Würfel\nmtllib körper.mtl\no Würfel\n{vertices}usemtl Körper\n{corners}");
    folder.write(
        "körper.mtl",
        latin("# Körper\nnewmtl Kürper\nKd 0 1 0\nnewmtl Körper\nKd 1 0 0\nmap_Kd rot.png\n"),
    );
    folder.write("rot.png", picture([250, 3, 4], ImageFormat::Png));
    let mesh = load(&folder.write("a.obj", latin(&obj)), 1.0).unwrap();
    assert_eq!(mesh.texture.as_ref().unwrap().get_pixel(0, 0).0, [250, 3, 4]);

    let ply = "ply\nformat ascii 1.0\ncomment café\nelement vertex 3\nproperty float x\nproperty float y\n\
               property float z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n\
               0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(load(&folder.write("a.ply", latin(ply)), 1.0).unwrap().faces, [[0, 1, 2]]);

    let stl = "solid Würfel\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
               endfacet\nendsolid Würfel\n";
    assert_eq!(load(&folder.write("a.stl", latin(stl)), 1.0).unwrap().faces, [[0, 1, 2]]);
}
