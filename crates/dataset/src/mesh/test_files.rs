//! Small files for the tests.

use std::path::PathBuf;

use serde_json::{Value, json};

/// A folder of files.
pub(super) struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }

    pub fn picture(&self, name: &str, color: [u8; 3]) {
        image::RgbImage::from_pixel(8, 8, image::Rgb(color)).save(self.0.path().join(name)).unwrap();
    }
}

/// A binary glTF file.
pub(super) fn glb(json: &str, buffer: &[u8]) -> Vec<u8> {
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let mut glb: Vec<u8> = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + buffer.len();
    for word in [2, total as u32, json.len() as u32, 0x4E4F_534A] {
        glb.extend(word.to_le_bytes());
    }
    glb.extend(json.as_bytes());
    for word in [buffer.len() as u32, 0x004E_4942] {
        glb.extend(word.to_le_bytes());
    }
    glb.extend(buffer);
    glb
}

/// Corners of a tetrahedron of 0.1 m.
pub(super) const CORNERS: [[f32; 3]; 4] = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
/// Its faces, outwards.
pub(super) const FACES: [[u16; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

/// JSON and buffer of a tetrahedron: positions, texture coordinates, colours red, green, blue, white, indices and a
/// picture in (9, 8, 7), which its material does not name.
pub(super) fn tetrahedron() -> (Value, Vec<u8>) {
    let mut buffer: Vec<u8> = CORNERS.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    buffer.extend([0f32, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0].iter().flat_map(|x| x.to_le_bytes()));
    buffer.extend([[255u8, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255; 4]].iter().flatten());
    buffer.extend(FACES.iter().flatten().flat_map(|i| i.to_le_bytes()));
    let picture = picture([9, 8, 7], image::ImageFormat::Png);
    let (start, length) = (buffer.len(), picture.len());
    buffer.extend(picture);
    buffer.resize(buffer.len().next_multiple_of(4), 0);
    let json = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [0.1, 0.1, 0.1]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5121, "count": 4, "type": "VEC4", "normalized": true},
            {"bufferView": 3, "componentType": 5123, "count": 12, "type": "SCALAR"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 32},
            {"buffer": 0, "byteOffset": 80, "byteLength": 16},
            {"buffer": 0, "byteOffset": 96, "byteLength": 24},
            {"buffer": 0, "byteOffset": start, "byteLength": length}],
        "buffers": [{"byteLength": buffer.len()}],
    });
    (json, buffer)
}

/// The tetrahedron with its picture as texture.
pub(super) fn textured_tetrahedron() -> (Value, Vec<u8>) {
    let (mut json, buffer) = tetrahedron();
    json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    (json, buffer)
}

/// A picture of 8 x 8 pixels as a file.
pub(super) fn picture(color: [u8; 3], format: image::ImageFormat) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(8, 8, image::Rgb(color)).write_to(&mut file, format).unwrap();
    file.into_inner()
}
