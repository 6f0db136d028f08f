//! What the parser fills.

use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

/// One vertex of the file, in its units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VertexRecord {
    pub position: [f32; 3],
    pub normal: [f32; 3],
    pub uv: [f32; 2],
    pub color: [u8; 3],
}

/// One polygon of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct FaceRecord {
    /// `None` when an index is negative.
    pub corners: Option<Vec<u32>>,
    /// u, v of every corner, or empty.
    pub corner_uvs: Vec<f32>,
    pub color: [u8; 3],
}

pub(super) const POSITION: [&str; 3] = ["x", "y", "z"];
pub(super) const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
pub(super) const UV: [&str; 2] = ["texture_u", "texture_v"];
pub(super) const COLOR: [&str; 3] = ["red", "green", "blue"];
/// Names other programs give the colours.
pub(super) const COLOR_ALIASES: [[&str; 3]; 2] =
    [["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
/// Names other programs give the texture coordinates.
pub(super) const UV_ALIASES: [[&str; 2]; 3] = [["s", "t"], ["u", "v"], ["texcoord_u", "texcoord_v"]];

fn color_index(name: &str) -> Option<usize> {
    let index = |names: &[&str]| names.iter().position(|&n| n == name);
    index(&COLOR).or_else(|| COLOR_ALIASES.iter().find_map(|names| index(names)))
}

fn set_color(channel: &mut u8, property: &Property) -> PropertyAccessResult {
    let Some(value) = property.to_u8_color_lossy() else { return PropertyAccessResult::UnsupportedType };
    *channel = value;
    PropertyAccessResult::Set
}

impl PropertyAccess for VertexRecord {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let index = |names: &[&str]| names.iter().position(|&n| n == name);
        if let Some(i) = color_index(name) {
            return set_color(&mut self.color[i], &property);
        }
        let uv_index = || UV_ALIASES.iter().find_map(|names| index(names)).or(index(&UV));
        let slot = match (index(&POSITION), index(&NORMAL), uv_index()) {
            (Some(i), _, _) => &mut self.position[i],
            (_, Some(i), _) => &mut self.normal[i],
            (_, _, Some(i)) => &mut self.uv[i],
            _ => return PropertyAccessResult::Ignored,
        };
        let Some(value) = property.to_f32_lossy() else { return PropertyAccessResult::UnsupportedType };
        *slot = value;
        PropertyAccessResult::Set
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let value = |names: &[&str], values: &[f32]| Some(values[names.iter().position(|&n| n == name)?]);
        value(&POSITION, &self.position)
            .or_else(|| value(&NORMAL, &self.normal))
            .or_else(|| value(&UV, &self.uv))
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        Some(self.color[COLOR.iter().position(|&n| n == name)?])
    }
}

impl PropertyAccess for FaceRecord {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if let Some(i) = color_index(name) {
            return set_color(&mut self.color[i], &property);
        }
        match (name, property) {
            ("vertex_indices" | "vertex_index", property) => self.corners = property.to_u32_list(),
            ("texcoord", Property::ListFloat(uvs)) => self.corner_uvs = uvs,
            ("texcoord", Property::ListDouble(uvs)) => {
                self.corner_uvs = uvs.iter().map(|&v| v as f32).collect()
            }
            ("texcoord", _) => return PropertyAccessResult::UnsupportedType,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    fn get_list_uint(&self, _name: &str) -> Option<&[u32]> {
        self.corners.as_deref()
    }
}
