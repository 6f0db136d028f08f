//! Files of every format with random changes: a mesh or an error, never a panic.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    test_files::{CORNERS, FACES, Folder, glb, textured_tetrahedron},
    *,
};

const MUTATIONS: u64 = 2500;
const CHARACTERS: &[u8] = b"0123456789-/. \n,[]{}\"";

/// One to four changes of bytes, digits, order or length.
fn mutate(bytes: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..8) {
            0..3 => bytes[at] ^= 1 << rng.random_range(0..8),
            3 => bytes[at] = rng.random(),
            4 => bytes[at] = CHARACTERS[rng.random_range(0..CHARACTERS.len())],
            5 => {
                let number: &[u8] =
                    [b"4294967295".as_slice(), b"-1", b"1e38", b"9999999999999999999"][at % 4];
                bytes.splice(at..at, number.iter().copied());
            }
            6 => {
                let end = (at + rng.random_range(1..40)).min(bytes.len());
                bytes.extend_from_within(at..end);
            }
            _ if at > 10 => bytes.truncate(at),
            _ => {}
        }
    }
    bytes
}

fn try_mutations(name: &str, bytes: &[u8]) {
    let folder = Folder::new();
    let whole = load(&folder.write(name, bytes), 1.0).unwrap();
    assert_eq!((whole.vertices.len(), whole.faces.len()), (4, 4), "{name}");
    let mut read = 0;
    for seed in 0..MUTATIONS {
        let mutated = mutate(bytes, &mut ChaCha8Rng::seed_from_u64(seed));
        match load(&folder.write(name, &mutated), 1.0) {
            Ok(mesh) => {
                read += 1;
                assert_eq!(mesh.validate(), Ok(()), "{name}, seed {seed}");
                let numbers = mesh.normals.iter().flatten().chain(mesh.uvs.iter().flatten());
                assert!(numbers.copied().all(f32::is_finite), "{name}, seed {seed}");
            }
            Err(error) => assert!(error.to_string().contains(name), "{name}, seed {seed}: {error}"),
        }
    }
    assert!((MUTATIONS / 50..MUTATIONS).contains(&read), "{name}: {read} of {MUTATIONS} were read");
}

#[test]
fn mutated_glbs() {
    let (json, buffer) = textured_tetrahedron();
    try_mutations("a.glb", &glb(&json.to_string(), &buffer));
}

#[test]
fn mutated_plys() {
    let mesh = TriangleMesh {
        vertices: CORNERS.to_vec(),
        faces: FACES.map(|f| f.map(u32::from)).to_vec(),
        normals: vec![[0.0, 0.0, 1.0]; 4],
        uvs: vec![[0.5, 0.25]; 4],
        colors: vec![[1, 2, 3]; 4],
        texture: None,
    };
    let mut binary = Vec::new();
    ply::write(&mesh, 1.0, None, &mut binary).unwrap();
    try_mutations("a.ply", &binary);
    let mut text = "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 4\nproperty float x\n\
                    property float y\nproperty double z\nproperty uchar red\nproperty uchar green\n\
                    property uchar blue\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
        .to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z} 1 2 3\n"));
    FACES.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    try_mutations("a.ply", text.as_bytes());
}

#[test]
fn mutated_objs() {
    let mut text = "mtllib a.mtl\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z} 1 0.5 0\n"));
    text += "vt 0 0\nvt 1 0\nvn 0 0 1\nusemtl a\n";
    FACES.iter().for_each(|f| {
        text += &format!("f {0}/1/1 {1}/1/1 {2}/1/1\n", f[0] + 1, f[1] + 1, f[2] + 1);
    });
    try_mutations("a.obj", text.as_bytes());
}

#[test]
fn mutated_stls() {
    let mut text = "solid a\n".to_owned();
    let mut binary = vec![0; 80];
    binary.extend(4u32.to_le_bytes());
    for face in FACES {
        let corners = face.map(|v| CORNERS[usize::from(v)]);
        text += "facet normal 0 0 1\nouter loop\n";
        corners.iter().for_each(|[x, y, z]| text += &format!("vertex {x} {y} {z}\n"));
        text += "endloop\nendfacet\n";
        binary.extend([0; 12]);
        binary.extend(corners.iter().flatten().flat_map(|x| x.to_le_bytes()));
        binary.extend([0; 2]);
    }
    text += "endsolid a\n";
    try_mutations("a.stl", text.as_bytes());
    try_mutations("a.stl", &binary);
}
