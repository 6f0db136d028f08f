//! Size, validity and closedness of a mesh.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};
use parry3d::transformation::try_convex_hull;

use super::{TriangleMesh, error::InvalidMesh};

/// Axis-aligned box, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: [f32; 3],
    /// Largest coordinates.
    pub max: [f32; 3],
}

impl Bounds {
    /// Middle of the box, metres.
    pub fn center(&self) -> [f32; 3] {
        std::array::from_fn(|i| 0.5 * (self.min[i] + self.max[i]))
    }

    /// Sides of the box, metres.
    pub fn size(&self) -> [f32; 3] {
        std::array::from_fn(|i| self.max[i] - self.min[i])
    }
}

/// Longest sides of a mesh, metres.
const PLAUSIBLE: std::ops::RangeInclusive<f32> = 1e-6..=1e3;
/// Below this many points the diameter is searched over all pairs.
const ALL_PAIRS: usize = 400;

impl TriangleMesh {
    /// Box around the vertices; all zero for an empty mesh.
    pub fn bounds(&self) -> Bounds {
        let Some(first) = self.vertices.first() else {
            return Bounds { min: [0.0; 3], max: [0.0; 3] };
        };
        self.vertices.iter().fold(Bounds { min: *first, max: *first }, |b, v| Bounds {
            min: std::array::from_fn(|i| b.min[i].min(v[i])),
            max: std::array::from_fn(|i| b.max[i].max(v[i])),
        })
    }

    /// Largest distance between two vertices, metres (BOP's `diameter`).
    pub fn diameter(&self) -> f32 {
        let hull = (self.vertices.len() > ALL_PAIRS).then(|| self.hull_vertices()).flatten();
        let points: &[Point3<f32>] = match &hull {
            Some(points) => points,
            None => &self.vertices.iter().map(|v| Point3::from(*v)).collect::<Vec<_>>(),
        };
        let mut largest = 0f32;
        for (i, a) in points.iter().enumerate() {
            for b in &points[i + 1..] {
                largest = largest.max((a - b).norm_squared());
            }
        }
        largest.sqrt()
    }

    /// Vertices of the convex hull; `None` when the cloud is too flat for a hull.
    fn hull_vertices(&self) -> Option<Vec<Point3<f32>>> {
        let points: Vec<_> = self.vertices.iter().map(|v| Point3::from(*v)).collect();
        try_convex_hull(&points).ok().map(|(vertices, _)| vertices)
    }

    /// Refuses empty meshes, NaN or infinite coordinates, sizes that no object has and indices out of range.
    pub fn validate(&self) -> Result<(), InvalidMesh> {
        let vertices = self.vertices.len();
        if vertices < 3 || self.faces.is_empty() {
            return Err(InvalidMesh::Empty { vertices, faces: self.faces.len() });
        }
        for (list, len) in
            [("normals", self.normals.len()), ("uvs", self.uvs.len()), ("colors", self.colors.len())]
        {
            if len != 0 && len != vertices {
                return Err(InvalidMesh::ListLength { list, len, vertices });
            }
        }
        if let Some((index, &value)) =
            self.vertices.iter().enumerate().find(|(_, v)| v.iter().any(|x| !x.is_finite()))
        {
            return Err(InvalidMesh::NotFinite { index, value });
        }
        for (face, corners) in self.faces.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertices) {
                return Err(InvalidMesh::FaceIndex { face, vertex, vertices });
            }
        }
        let extent = self.bounds().size().into_iter().fold(0.0, f32::max);
        if !PLAUSIBLE.contains(&extent) {
            return Err(InvalidMesh::Extent { extent });
        }
        if self.area() <= 0.0 { Err(InvalidMesh::ZeroArea) } else { Ok(()) }
    }

    /// Multiplies the coordinates of the vertices.
    pub fn scale(&mut self, factor: f32) {
        self.vertices.iter_mut().flatten().for_each(|x| *x *= factor);
    }

    /// Moves the centre of the bounding box to the origin.
    pub fn center_on_bounds(&mut self) {
        let center = self.bounds().center();
        for v in &mut self.vertices {
            *v = std::array::from_fn(|i| v[i] - center[i]);
        }
    }

    /// Surface area, square metres.
    pub fn area(&self) -> f64 {
        self.faces.iter().map(|f| 0.5 * f64::from(self.face_cross(f).norm())).sum()
    }

    /// Signed volume by the divergence theorem, cubic metres; positive when the faces of a closed mesh point outwards.
    pub fn volume(&self) -> f64 {
        let corner = |i: u32| Vector3::from(self.vertices[i as usize]).cast::<f64>();
        self.faces.iter().map(|f| corner(f[0]).dot(&corner(f[1]).cross(&corner(f[2]))) / 6.0).sum()
    }

    /// Twice the area vector of a face.
    pub(super) fn face_cross(&self, face: &[u32; 3]) -> Vector3<f32> {
        let [a, b, c] = face.map(|i| Vector3::from(self.vertices[i as usize]));
        (b - a).cross(&(c - a))
    }

    /// Faces without area are left out.
    pub(super) fn remove_degenerate_faces(&mut self) {
        let keep: Vec<bool> = self.faces.iter().map(|f| self.face_cross(f).norm_squared() > 0.0).collect();
        let mut kept = keep.iter();
        self.faces.retain(|_| kept.next().copied().unwrap_or(false));
    }

    /// Number of directed edges without their opposite once vertices at equal positions are merged: 0 for a closed,
    /// consistently oriented surface.
    pub fn open_edges(&self) -> usize {
        let mut ids = HashMap::new();
        let welded: Vec<u32> = self
            .vertices
            .iter()
            .map(|v| {
                let next = ids.len() as u32;
                // -0.0 and 0.0 are the same place.
                *ids.entry(v.map(|x| (x + 0.0).to_bits())).or_insert(next)
            })
            .collect();
        let mut balance: HashMap<(u32, u32), i64> = HashMap::new();
        for face in &self.faces {
            for k in 0..3 {
                let (a, b) = (welded[face[k] as usize], welded[face[(k + 1) % 3] as usize]);
                match a.cmp(&b) {
                    std::cmp::Ordering::Less => *balance.entry((a, b)).or_default() += 1,
                    std::cmp::Ordering::Greater => *balance.entry((b, a)).or_default() -= 1,
                    std::cmp::Ordering::Equal => {}
                }
            }
        }
        balance.values().map(|b| b.unsigned_abs() as usize).sum()
    }
}
