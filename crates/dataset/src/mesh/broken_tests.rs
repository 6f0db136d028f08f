//! Files that contradict themselves: an error with the file, what is wrong and the value met.

use serde_json::{Value, json};

use super::{
    test_files::{Folder, glb, tetrahedron, textured_tetrahedron},
    *,
};

fn message(name: &str, content: impl AsRef<[u8]>) -> String {
    let message = load(&Folder::new().write(name, content), 1.0).unwrap_err().to_string();
    assert!(message.contains(name), "{message}");
    message
}

#[test]
fn a_glb_that_contradicts_itself_is_refused_with_the_place() {
    let huge = json!(u64::MAX);
    let twice: Vec<Value> =
        (1..=30).map(|i| json!({"children": [i, i]})).chain([json!({"mesh": 0})]).collect();
    let chain = json!(twice);
    for (place, value, part) in [
        ("/accessors/3/componentType", json!(5126), "accessors[3]: indices are F32, expected U8"),
        ("/accessors/3/componentType", json!(7), "accessors[3]: unknown componentType"),
        ("/accessors/0/type", json!("VEC2"), "accessors[0]: type is Vec2, expected one of [Vec3]"),
        ("/accessors/0/count", json!(0), "accessors[3]: index 0 is vertex 0, but there are only 0"),
        ("/accessors/0/count", json!(3), "accessors[3]: index 5 is vertex 3, but there are only 3"),
        ("/accessors/0/count", json!(5), "5 elements of 12 bytes every 12 from 0 on, but the view has 48"),
        ("/accessors/0/count", json!(4_000_000_000u32), "count is 4000000000, but the buffers have"),
        ("/accessors/0/byteOffset", huge.clone(), "but the view has 48"),
        ("/accessors/0/bufferView", json!(99), "bufferViews[99] is referred to, but there are only 5"),
        ("/accessors", json!([]), "accessors[0] is referred to, but there are only 0"),
        ("/bufferViews/0/byteStride", json!(4), "accessors[0]: byteStride is 4, but an element has 12 bytes"),
        ("/bufferViews/0/byteStride", huge.clone(), "but the view has 48"),
        ("/bufferViews/0/byteLength", huge.clone(), "bufferViews[0] is bytes 0 to"),
        ("/bufferViews/0/buffer", json!(3), "buffers[3] is referred to"),
        ("/buffers/0/byteLength", huge, "byteLength says 18446744073709551615"),
        ("/buffers/0/uri", json!("/etc/hostname"), "expected a file in the folder of the mesh"),
        ("/buffers/0/uri", json!("..%2Fb.bin"), "expected a file in the folder of the mesh"),
        ("/buffers/0/uri", json!("file:///etc/hostname"), "expected a file in the folder of the mesh"),
        ("/buffers/0/uri", json!("b.bin"), "buffers[0]: uri \"b.bin\": No such file"),
        ("/buffers/0/uri", json!("data:,AAAA"), "expected base64"),
        ("/nodes/1/children", json!([0]), "nodes[0] is reached twice"),
        ("/nodes", chain, "nodes[30] is reached twice"),
        ("/nodes/0/children", json!([8]), "nodes[8] is referred to, but there are only 2"),
        ("/nodes/1/mesh", json!(1), "meshes[1] is referred to"),
        ("/meshes/0/primitives/0/material", json!(6), "materials[6] is referred to"),
        ("/meshes/0/primitives/0/attributes", json!({}), "primitive without positions"),
        ("/scene", json!(1), "scenes[1] is referred to"),
        ("/extensionsRequired", json!(["KHR_draco_mesh_compression"]), "needs the extension KHR_draco"),
    ] {
        let (mut gltf, buffer) = textured_tetrahedron();
        let (parent, key) = place.rsplit_once('/').unwrap();
        gltf.pointer_mut(parent).unwrap()[key] = value;
        let message = message("a.glb", glb(&gltf.to_string(), &buffer));
        assert!(message.contains(part), "{place}: {message}");
    }
}

#[test]
fn a_glb_cannot_grow_by_showing_its_mesh_again_and_again() {
    let (mut gltf, buffer) = tetrahedron();
    let nodes = vec![json!({"mesh": 0}); 100_000];
    gltf["scenes"][0]["nodes"] = (0..nodes.len()).collect();
    gltf["nodes"] = nodes.into();
    assert!(message("a.glb", glb(&gltf.to_string(), &buffer)).contains("cannot be what is meant"));
    gltf["nodes"] = vec![json!({}); 200_001].into();
    assert!(message("a.glb", glb(&gltf.to_string(), &buffer)).contains("expected at most 200000"));
}

#[test]
fn sparse_accessors_are_filled_and_checked() {
    let (mut gltf, buffer) = tetrahedron();
    let folder = Folder::new();
    // The first index as a place, the first position as its value.
    let sparse = json!({"count": 1, "indices": {"bufferView": 3, "byteOffset": 2, "componentType": 5123},
        "values": {"bufferView": 0, "byteOffset": 36}});
    gltf["accessors"][0]["sparse"] = sparse;
    let mesh = load(&folder.write("a.glb", glb(&gltf.to_string(), &buffer)), 1.0).unwrap();
    assert_eq!((mesh.vertices[2], mesh.vertices[3]), ([0.0, 0.0, 0.1], [0.0, 0.0, 0.1]));
    gltf["accessors"][0]["sparse"]["count"] = json!(5);
    assert!(message("a.glb", glb(&gltf.to_string(), &buffer)).contains("sparse.count is 5, but count is 4"));
    gltf["accessors"][0]["sparse"]["count"] = json!(1);
    gltf["accessors"][0]["sparse"]["indices"] = json!({"bufferView": 2, "componentType": 5121});
    assert!(message("a.glb", glb(&gltf.to_string(), &buffer)).contains("sparse index 255, but count is 4"));
}

#[test]
fn a_header_that_says_more_than_the_file_holds_is_refused() {
    let ply = |format: &str, elements: &str| format!("ply\nformat {format} 1.0\n{elements}end_header\n");
    let (binary, ascii) = ("binary_little_endian", "ascii");
    let vertex = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let many = vertex.replace('3', "10000000000");
    let mut payload = ply(binary, &format!("{vertex}element face 10000000000\n"));
    payload += &"\0".repeat(36);
    for (content, part) in [
        (payload, "element face has 10000000000 entries without any property"),
        (ply(binary, &many), "vertex has 10000000000 entries of at least 12 bytes, but only 0 bytes follow"),
        (ply(ascii, &many), "vertex has 10000000000 entries of at least 6 bytes"),
        (ply(ascii, vertex) + "0 0 0\n0 0 0 0 0 0 0 0\n", "vertex 2: the file ends, expected 3 entries"),
    ] {
        let message = message("a.ply", content);
        assert!(message.contains(part), "{message}");
    }
    let long = format!("{}{}\n", ply(ascii, vertex), "x".repeat(100_000));
    assert!(message("a.ply", long).len() < 600);

    let mut stl = vec![0; 84 + 50];
    stl[80..84].fill(255);
    let part = "says 4294967295 triangles, which are 214748364834 bytes; the file has 134";
    assert!(message("a.stl", &stl).contains(part));
    assert!(message("a.stl", &stl[..50]).contains("50 bytes, expected at least 84"));
}

#[test]
fn a_binary_stl_may_begin_with_solid() {
    let mut stl = b"solid part".to_vec();
    stl.resize(80, b' ');
    stl.extend(1u32.to_le_bytes());
    for x in [0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        stl.extend(x.to_le_bytes());
    }
    stl.extend([0, 0]);
    let mesh = load(&Folder::new().write("a.stl", stl), 1.0).unwrap();
    assert_eq!(mesh.vertices, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
}

#[test]
fn a_line_of_an_obj_that_cannot_be_read_is_named() {
    let vertices = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nvt 0 0\n";
    for (line, part) in [
        ("f 1 2 9", "line 5: a face refers to vertex 9, but there are only 3"),
        ("f 1/7 2/1 3/1", "line 5: a face refers to texture coordinate 7, but there are only 1"),
        ("f 1 2 -4", "line 5: a face refers to vertex -4, but there are 3 so far"),
        ("f 1/9223372036854775807 2 3", "line 5: a face refers to texture coordinate 9223372036854775807"),
        ("f 1/-9223372036854775808 2 3", "line 5: a face refers to texture coordinate -9223372036854775808"),
        ("f 1 2 0", "vertex 0"),
        ("f 1 2 x", "line 5: corner \"x\" of a face"),
        ("f 1/1/1/1 2 3", "line 5: corner"),
        ("v 1 2", "line 5: \"v 1 2\": position parse error"),
        ("v 1 2 z", "line 5: \"v 1 2 z\": position parse error"),
    ] {
        let message = message("a.obj", format!("{vertices}{line}\nf 1 2 3\n"));
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn sizes_that_no_object_has_are_refused_with_the_size() {
    let of_size = |x: &str| format!("v 0 0 0\nv {x} 0 0\nv 0 1e-8 0\nf 1 2 3\n");
    assert!(message("a.obj", of_size("1e30")).contains("extends over 1e30 m, expected 1e-6 to 1e3 m"));
    assert!(message("a.obj", of_size("1e-7")).contains("extends over 1e-7 m"));
    assert!(message("a.obj", of_size("1e39")).contains("vertex 1 is [inf, 0.0, 0.0], expected finite"));
    assert!(load(&Folder::new().write("a.obj", of_size("1")), 1.0).is_ok());
}

#[test]
fn a_polygon_of_many_corners_is_a_mesh() {
    let count = 200_000;
    let mut text = String::new();
    for i in 0..count {
        let (y, x) = (i as f64 / count as f64 * std::f64::consts::TAU).sin_cos();
        text += &format!("v {x} {y} 0\n");
    }
    text += "f";
    (1..=count).for_each(|i| text += &format!(" {i}"));
    let mesh = load(&Folder::new().write("a.obj", text), 1.0).unwrap();
    assert!((mesh.area() - std::f64::consts::PI).abs() < 1e-3, "{}", mesh.area());
    assert!((mesh.diameter() - 2.0).abs() < 1e-6);
}

#[cfg(unix)]
#[test]
fn special_files_are_neither_meshes_nor_materials_nor_textures() {
    let folder = Folder::new();
    let pipe = folder.0.path().join("pipe.obj");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    assert!(load(&pipe, 1.0).unwrap_err().to_string().contains("device, expected a regular file"));
    let vertices = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n";
    let device = format!("mtllib /dev/zero\n{vertices}usemtl a\nf 1 2 3\n");
    assert_eq!(load(&folder.write("a.obj", device), 1.0).unwrap().faces.len(), 1);
    folder.write("a.mtl", "newmtl a\nKd 1\nmap_Kd /dev/zero\n");
    let texture = format!("mtllib a.mtl\n{vertices}vt 0 0\nusemtl a\nf 1/1 2/1 3/1\n");
    assert!(load(&folder.write("b.obj", texture), 1.0).unwrap().texture.is_none());
}
