//! Vertex normals, smooth or with creases.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::TriangleMesh;

impl TriangleMesh {
    /// Area-weighted vertex normals; a vertex without area gets (0, 0, 1).
    pub(super) fn compute_normals(&mut self) {
        let mut sums = vec![Vector3::zeros(); self.vertices.len()];
        for face in &self.faces {
            let cross = self.face_cross(face);
            for &i in face {
                sums[i as usize] += cross;
            }
        }
        self.normals = sums.iter().map(unit_or_z).collect();
    }
}

fn unit_or_z(v: &Vector3<f32>) -> [f32; 3] {
    v.try_normalize(0.0).unwrap_or_else(Vector3::z).into()
}

/// Vertices of the result are the distinct (vertex, corner normal, chart) triples of a mesh with shared vertices.
///
/// The normal of a face corner averages (by area) the faces around that vertex whose normals differ by less than
/// `crease_deg`; `chart` gives every face a number, and corners of different charts never share a vertex, so that
/// texture coordinates may jump there. Returns the mesh and, per new vertex, the old vertex and the chart.
pub fn split_by_crease(
    mesh: &TriangleMesh,
    crease_deg: f32,
    chart: impl Fn(usize) -> u8,
) -> (TriangleMesh, Vec<(u32, u8)>) {
    let crosses: Vec<Vector3<f32>> = mesh.faces.iter().map(|f| mesh.face_cross(f)).collect();
    let units: Vec<Vector3<f32>> =
        crosses.iter().map(|c| c.try_normalize(0.0).unwrap_or_else(Vector3::zeros)).collect();
    let mut around = vec![Vec::new(); mesh.vertices.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        face.iter().for_each(|&v| around[v as usize].push(f as u32));
    }
    let cos_crease = crease_deg.to_radians().cos();
    let mut split = TriangleMesh::default();
    let mut origin = Vec::new();
    let mut known: HashMap<(u32, [i16; 3], u8), u32> = HashMap::new();
    for (f, face) in mesh.faces.iter().enumerate() {
        let corners = face.map(|v| {
            let sum = around[v as usize]
                .iter()
                .filter(|&&g| units[g as usize].dot(&units[f]) > cos_crease)
                .fold(Vector3::zeros(), |sum, &g| sum + crosses[g as usize]);
            let normal = unit_or_z(&sum);
            let key = (v, normal.map(|x| (x * 8192.0).round() as i16), chart(f));
            *known.entry(key).or_insert_with(|| {
                split.vertices.push(mesh.vertices[v as usize]);
                split.normals.push(normal);
                origin.push((v, key.2));
                origin.len() as u32 - 1
            })
        });
        split.faces.push(corners);
    }
    (split, origin)
}
