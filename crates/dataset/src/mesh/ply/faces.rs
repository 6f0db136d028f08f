//! Polygons as triangles.

use std::collections::HashMap;

use super::{super::TriangleMesh, records::FaceRecord};

/// The polygons of a file.
#[derive(Debug, Default)]
pub(super) struct Faces {
    /// Vertex indices of all of them.
    corners: Vec<u32>,
    /// u, v of their corners; none for polygons without.
    corner_uvs: Vec<f32>,
    /// Ends of every polygon in the two lists.
    ends: Vec<[usize; 2]>,
    /// sRGB of every polygon, where they have colours.
    colors: Vec<[u8; 3]>,
}

impl Faces {
    pub fn push(&mut self, face: &FaceRecord, colored: bool) -> Result<(), String> {
        let corners = face.corners.as_ref().ok_or("vertex_indices missing, negative or not integers")?;
        self.corners.extend(corners);
        self.corner_uvs.extend(&face.corner_uvs);
        self.ends.push([self.corners.len(), self.corner_uvs.len()]);
        if colored {
            self.colors.push(face.color);
        }
        Ok(())
    }

    pub fn are_colored(&self) -> bool {
        !self.colors.is_empty()
    }

    /// Fans of triangles; vertices whose corners have different texture coordinates or colours are split.
    pub fn add_to(self, mesh: &mut TriangleMesh) -> Result<(), String> {
        let vertex_count = mesh.vertices.len();
        let with_corner_uvs = mesh.uvs.is_empty() && !self.corner_uvs.is_empty();
        if with_corner_uvs {
            mesh.uvs = vec![[f32::NAN; 2]; vertex_count];
        }
        let with_colors = mesh.colors.is_empty() && self.are_colored();
        let mut split = Split::default();
        let mut colors = Vec::new();
        let mut start = [0, 0];
        for (number, &end) in self.ends.iter().enumerate() {
            let mut corners = self.corners[start[0]..end[0]].to_vec();
            let corner_uvs = &self.corner_uvs[start[1]..end[1]];
            start = end;
            if let Some(&vertex) = corners.iter().find(|&&c| c as usize >= vertex_count) {
                return Err(format!(
                    "face {number} refers to vertex {vertex}, but there are only {vertex_count}"
                ));
            }
            if with_corner_uvs {
                if corner_uvs.len() != 2 * corners.len() {
                    let (met, expected) = (corner_uvs.len(), 2 * corners.len());
                    return Err(format!("face {number}: texcoord has {met} numbers, expected {expected}"));
                }
                for (corner, uv) in corners.iter_mut().zip(corner_uvs.chunks_exact(2)) {
                    *corner = split.by_uv(mesh, *corner, [uv[0], uv[1]]);
                }
            }
            if with_colors {
                for corner in &mut corners {
                    *corner = split.by_color(mesh, &mut colors, *corner, self.colors[number]);
                }
            }
            mesh.faces.extend((2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]));
        }
        for uv in mesh.uvs.iter_mut().filter(|uv| uv[0].is_nan()) {
            *uv = [0.0; 2];
        }
        if with_colors {
            colors.resize(mesh.vertices.len(), None);
            mesh.colors = colors.into_iter().map(Option::unwrap_or_default).collect();
        }
        Ok(())
    }
}

/// Vertices that were made because one had to have several values.
#[derive(Default)]
struct Split {
    by_uv: HashMap<(u32, [u32; 2]), u32>,
    by_color: HashMap<(u32, [u8; 3]), u32>,
}

impl Split {
    /// The vertex like `vertex` whose texture coordinate is `uv`, made when there is none yet.
    fn by_uv(&mut self, mesh: &mut TriangleMesh, vertex: u32, uv: [f32; 2]) -> u32 {
        *self.by_uv.entry((vertex, uv.map(f32::to_bits))).or_insert_with(|| {
            if mesh.uvs[vertex as usize][0].is_nan() {
                mesh.uvs[vertex as usize] = uv;
                return vertex;
            }
            let made = twin(mesh, vertex);
            mesh.uvs[made as usize] = uv;
            made
        })
    }

    /// The same for colours.
    fn by_color(
        &mut self,
        mesh: &mut TriangleMesh,
        colors: &mut Vec<Option<[u8; 3]>>,
        vertex: u32,
        color: [u8; 3],
    ) -> u32 {
        *self.by_color.entry((vertex, color)).or_insert_with(|| {
            colors.resize(mesh.vertices.len(), None);
            let made = if colors[vertex as usize].is_some() { twin(mesh, vertex) } else { vertex };
            colors.resize(mesh.vertices.len(), None);
            colors[made as usize] = Some(color);
            made
        })
    }
}

/// A new vertex with everything that `vertex` has.
fn twin(mesh: &mut TriangleMesh, vertex: u32) -> u32 {
    fn repeat<T: Copy>(list: &mut Vec<T>, v: usize) {
        if let Some(&value) = list.get(v) {
            list.push(value);
        }
    }
    let v = vertex as usize;
    repeat(&mut mesh.vertices, v);
    repeat(&mut mesh.normals, v);
    repeat(&mut mesh.uvs, v);
    repeat(&mut mesh.colors, v);
    (mesh.vertices.len() - 1) as u32
}
