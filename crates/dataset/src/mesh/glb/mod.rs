//! glTF 2.0 (binary or with separate buffers): all triangle primitives of the default scene with their base colours.
//!
//! The file is read as its JSON describes it; nothing of the JSON is relied on that has not been checked here.

mod buffers;
mod materials;

use std::path::Path;

use gltf::{
    Glb, Semantic,
    json::{
        Root,
        accessor::Type,
        mesh::{Mode, Primitive},
        scene::Node,
        validation::Checked,
    },
    scene::Transform,
};
use nalgebra::{Matrix4, Point3};

use self::{
    buffers::{Buffers, entry},
    materials::{Materials, srgb},
};
use super::{MeshError, TriangleMesh, file::read_regular};

/// Extensions that may be required: they are read, or change nothing that a mesh here has.
const KNOWN_EXTENSIONS: [&str; 4] =
    ["EXT_texture_webp", "KHR_mesh_quantization", "KHR_texture_transform", "KHR_lights_punctual"];
/// Objects of the JSON; one takes a few hundred bytes in memory.
const MOST_OBJECTS: usize = 200_000;
/// Corners and vertices that nodes may make of few bytes by showing a mesh again and again.
const FREE_INSTANCES: usize = 1_000_000;
/// The same per byte of the buffers.
const INSTANCES_PER_BYTE: usize = 16;

pub(super) fn read(path: &Path) -> Result<TriangleMesh, MeshError> {
    read_regular(path).and_then(|bytes| parse(path, &bytes)).map_err(|reason| MeshError::read(path, reason))
}

fn parse(path: &Path, bytes: &[u8]) -> Result<TriangleMesh, String> {
    let (json, blob) = parts(bytes)?;
    let objects = json.iter().filter(|&&b| b == b'{').count();
    if objects > MOST_OBJECTS {
        return Err(format!("the JSON has {objects} objects, expected at most {MOST_OBJECTS}"));
    }
    let root = Root::from_slice(json).map_err(|e| format!("glTF JSON: {e}"))?;
    let known = |name: &str| KNOWN_EXTENSIONS.contains(&name) || name.starts_with("KHR_materials_");
    if let Some(name) = root.extensions_required.iter().find(|name| !known(name)) {
        return Err(format!("needs the extension {name}, which cannot be read"));
    }
    let buffers = Buffers::read(&root, path.parent().unwrap_or(Path::new("")), blob)?;
    let mut reader = Reader {
        root: &root,
        buffers: &buffers,
        materials: Materials::new(path, &root, &buffers),
        mesh: TriangleMesh::default(),
        of_face: Vec::new(),
        colored: false,
        instances_left: FREE_INSTANCES + INSTANCES_PER_BYTE * buffers.total(),
        left_out: 0,
    };
    reader.scene()?;
    let Reader { mut mesh, materials, of_face, left_out, colored, .. } = reader;
    if left_out > 0 {
        tracing::warn!("{}: {left_out} primitives are no triangle lists; left out", path.display());
    }
    if !colored {
        mesh.colors.clear();
    }
    mesh.paint(path, &materials.finish(), &of_face);
    Ok(mesh)
}

/// The JSON and the binary part.
fn parts(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let length = word(8).map_or(0, |length| length as usize);
    if length < 12 || length > bytes.len() {
        return Err(format!("the header says {length} bytes, the file has {}", bytes.len()));
    }
    let glb = Glb::from_slice(&bytes[..length]).map_err(|e| format!("binary glTF: {e}"))?;
    let borrowed = |part| match part {
        std::borrow::Cow::Borrowed(part) => Ok(part),
        std::borrow::Cow::Owned(_) => Err("binary glTF: not in one piece".to_owned()),
    };
    Ok((borrowed(glb.json)?, glb.bin.map(borrowed).transpose()?))
}

struct Reader<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    materials: Materials<'a>,
    mesh: TriangleMesh,
    of_face: Vec<u32>,
    /// Whether a primitive has colours of its own.
    colored: bool,
    /// Corners and vertices that may still be made.
    instances_left: usize,
    /// Primitives that are no triangle lists.
    left_out: usize,
}

impl Reader<'_> {
    fn scene(&mut self) -> Result<(), String> {
        let scene = match self.root.scene {
            Some(index) => entry(&self.root.scenes, index.value(), "scenes")?,
            None => self.root.scenes.first().ok_or("no scene")?,
        };
        let mut pending: Vec<(usize, Matrix4<f32>)> =
            scene.nodes.iter().map(|n| (n.value(), Matrix4::identity())).collect();
        let mut reached = vec![false; self.root.nodes.len()];
        while let Some((index, parent)) = pending.pop() {
            let node = entry(&self.root.nodes, index, "nodes")?;
            if std::mem::replace(&mut reached[index], true) {
                return Err(format!("nodes[{index}] is reached twice; nodes have one parent at most"));
            }
            let t_scene_node = parent * Matrix4::from(transform(node).matrix());
            let children = node.children.iter().flatten();
            pending.extend(children.map(|child| (child.value(), t_scene_node)));
            if let Some(mesh) = node.mesh {
                for primitive in &entry(&self.root.meshes, mesh.value(), "meshes")?.primitives {
                    match primitive.mode {
                        Checked::Valid(Mode::Triangles) => self.append(primitive, &t_scene_node)?,
                        _ => self.left_out += 1,
                    }
                }
            }
        }
        Ok(())
    }

    fn append(&mut self, primitive: &Primitive, t_scene_node: &Matrix4<f32>) -> Result<(), String> {
        let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let positions = attribute(Semantic::Positions).ok_or("primitive without positions")?;
        let count = self.buffers.count(positions)?;
        let corners = primitive.indices.map_or(Ok(0), |indices| self.buffers.count(indices))?;
        self.instances_left = self.instances_left.checked_sub(count + corners).ok_or_else(|| {
            format!(
                "the nodes show so many meshes that {} bytes cannot be what is meant",
                self.buffers.total()
            )
        })?;
        let offset = self.mesh.vertices.len() as u32;
        let placed = |p: &[f32; 4]| -> [f32; 3] {
            t_scene_node.transform_point(&Point3::new(p[0], p[1], p[2])).into()
        };
        self.mesh.vertices.extend(self.buffers.vectors(positions, &[Type::Vec3])?.iter().map(placed));
        let indices = match primitive.indices {
            Some(indices) => self.buffers.indices(indices, count)?,
            None => (0..count as u32).collect(),
        };
        self.mesh
            .faces
            .extend(indices.chunks_exact(3).map(|f| [f[0] + offset, f[1] + offset, f[2] + offset]));
        let (material, tex_coord) = self.materials.use_material(primitive.material)?;
        self.of_face.resize(self.mesh.faces.len(), material);
        // glTF puts the texture origin at the top left.
        let uvs = match attribute(Semantic::TexCoords(tex_coord)) {
            Some(uvs) => self.buffers.vectors(uvs, &[Type::Vec2])?,
            None => Vec::new(),
        };
        self.mesh.uvs.extend(uvs.iter().take(count).map(|uv| [uv[0], 1.0 - uv[1]]));
        self.mesh.uvs.resize(self.mesh.vertices.len(), [0.0, 0.0]);
        let factor = self.materials.factor(material);
        if let Some(colors) = attribute(Semantic::Colors(0)) {
            let colors = self.buffers.vectors(colors, &[Type::Vec3, Type::Vec4])?;
            let color = |c: &[f32; 4]| std::array::from_fn(|i| srgb(c[i] * factor[i]));
            self.mesh.colors.extend(colors.iter().take(count).map(color));
            self.colored = true;
        }
        self.mesh.colors.resize(self.mesh.vertices.len(), self.materials.color(material));
        Ok(())
    }
}

fn transform(node: &Node) -> Transform {
    match node.matrix {
        Some(m) => {
            Transform::Matrix { matrix: std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j])) }
        }
        None => Transform::Decomposed {
            translation: node.translation.unwrap_or([0.0; 3]),
            rotation: node.rotation.unwrap_or_default().0,
            scale: node.scale.unwrap_or([1.0; 3]),
        },
    }
}
