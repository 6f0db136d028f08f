//! Directions spread over the sphere.

use std::collections::BTreeMap;

use nalgebra::Vector3;

/// The vertices of an icosahedron whose faces were divided into four `subdivisions` times, as unit vectors:
/// `10 * 4^subdivisions + 2` of them (12, 42, 162, ...).
pub fn icosphere(subdivisions: u32) -> Vec<Vector3<f64>> {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut vertices: Vec<Vector3<f64>> = Vec::new();
    // The corners of three rectangles of golden ratio.
    for axis in 0..3 {
        for (short, long) in [(-1.0, -golden), (-1.0, golden), (1.0, -golden), (1.0, golden)] {
            let mut corner = Vector3::zeros();
            (corner[axis], corner[(axis + 1) % 3]) = (short, long);
            vertices.push(corner.normalize());
        }
    }
    let mut faces = nearest_triples(&vertices);
    for _ in 0..subdivisions {
        let mut middles: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        let mut middle = |a: usize, b: usize| {
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                vertices.push((vertices[a] + vertices[b]).normalize());
                vertices.len() - 1
            })
        };
        let divided = faces.iter().flat_map(|&[a, b, c]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
        });
        faces = divided.collect();
    }
    vertices
}

/// Triples of an icosahedron's vertices that are neighbours of each other: its 20 faces.
fn nearest_triples(vertices: &[Vector3<f64>]) -> Vec<[usize; 3]> {
    // Neighbours are 63.4 degrees apart, the next vertices 116.6.
    let near = |a: usize, b: usize| vertices[a].dot(&vertices[b]) > 0.0;
    let count = vertices.len();
    let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
    pairs
        .filter(|&(a, b)| near(a, b))
        .flat_map(|(a, b)| (b + 1..count).filter(move |&c| near(a, c) && near(b, c)).map(move |c| [a, b, c]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_unit_balanced_and_evenly_spread() {
        for (subdivisions, count, apart_deg) in [(0, 12, 63.4), (1, 42, 31.7), (2, 162, 15.8)] {
            let vertices = icosphere(subdivisions);
            assert_eq!(vertices.len(), count);
            assert!(vertices.iter().all(|v| (v.norm() - 1.0).abs() < 1e-12));
            assert!(vertices.iter().sum::<Vector3<f64>>().norm() < 1e-9);
            let nearest = |i: usize| {
                let others = (0..count).filter(|&j| j != i);
                others.map(|j| vertices[i].dot(&vertices[j])).fold(-1.0, f64::max).acos().to_degrees()
            };
            let least = (0..count).map(nearest).fold(180.0, f64::min);
            assert!((least - apart_deg).abs() < 0.06, "{least}");
        }
    }
}
