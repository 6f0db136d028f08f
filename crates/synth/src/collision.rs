//! Shapes that objects collide with: a convex hull, or several where the object is hollow, bent or branched.

use std::panic::catch_unwind;

use nalgebra::{Point3, Vector3};
use parry3d::transformation::{
    try_convex_hull,
    vhacd::{VHACD, VHACDParameters},
};
use unopose_dataset::mesh::TriangleMesh;

/// Least number of directions in which the hull of an object touches the mesh.
const HULL_DIRECTIONS: usize = 100;
/// The same for each of several convex parts.
const PART_DIRECTIONS: usize = 32;
/// Vertices that stick out of the hull by more than this become part of it, metres.
const HULL_TOLERANCE: f32 = 3e-4;
/// An object that fills less of its hull than this is decomposed.
const SOLID: f64 = 0.8;
/// Meshes with more faces keep their hull: the voxelisation would take seconds.
const MOST_FACES: usize = 60_000;
/// Voxels along the longest side of an object that is decomposed; the next where the one before fails.
const RESOLUTIONS: [u32; 2] = [24, 29];

/// Corners and faces of convex parts.
type Hulls = Vec<(Vec<Point3<f32>>, Vec<[u32; 3]>)>;

/// Convex hull that lies at most about [`HULL_TOLERANCE`] inside the mesh's own.
pub(super) fn collision_hull(vertices: &[[f32; 3]]) -> Vec<Point3<f32>> {
    hull(vertices, HULL_DIRECTIONS)
}

/// Convex parts that cover the surface (Mamou 2016, VHACD); empty where the hull alone is good enough.
pub(super) fn convex_parts(mesh: &TriangleMesh, hull: &[Point3<f32>]) -> Vec<Vec<Point3<f32>>> {
    let filled = mesh.volume() / hull_volume(hull).max(1e-12);
    if filled > SOLID || mesh.faces.len() > MOST_FACES {
        return Vec::new();
    }
    let points: Vec<Point3<f32>> = mesh.vertices.iter().map(|v| Point3::from(*v)).collect();
    let Some(hulls) = RESOLUTIONS.iter().find_map(|&resolution| decompose(&points, &mesh.faces, resolution))
    else {
        return Vec::new();
    };
    let vertices = |part: &[Point3<f32>]| part.iter().map(|p| p.coords.into()).collect::<Vec<[f32; 3]>>();
    let parts: Vec<_> = hulls.iter().map(|(part, _)| self::hull(&vertices(part), PART_DIRECTIONS)).collect();
    if parts.len() > 1 { parts } else { Vec::new() }
}

/// The hulls of a decomposition; `None` where the library cannot make one: its own hulls of a few voxels panic on some shapes.
fn decompose(points: &[Point3<f32>], faces: &[[u32; 3]], resolution: u32) -> Option<Hulls> {
    let parameters =
        VHACDParameters { resolution, concavity: 0.03, max_convex_hulls: 12, ..Default::default() };
    let decomposed = catch_unwind(|| {
        VHACD::decompose(&parameters, points, faces, true).compute_exact_convex_hulls(points, faces)
    });
    decomposed
        .inspect_err(|_| tracing::warn!("a shape cannot be decomposed with {resolution} voxels a side"))
        .ok()
}

fn hull_volume(points: &[Point3<f32>]) -> f64 {
    try_convex_hull(points).map_or(0.0, |(corners, faces)| {
        let vertices = corners.iter().map(|p| p.coords.into()).collect();
        TriangleMesh { vertices, faces, ..Default::default() }.volume().abs()
    })
}

/// Vertices farthest out in evenly spread directions, then along the normals of the faces found so far.
fn hull(vertices: &[[f32; 3]], directions: usize) -> Vec<Point3<f32>> {
    let reach = |v: &[f32; 3], d: &Vector3<f32>| Vector3::from(*v).dot(d);
    let farthest = |d: &Vector3<f32>| {
        let by_reach = |a: &&[f32; 3], b: &&[f32; 3]| reach(a, d).total_cmp(&reach(b, d));
        vertices.iter().max_by(by_reach).copied()
    };
    let mut points: Vec<[f32; 3]> = (0..directions)
        .filter_map(|i| {
            // Fibonacci sphere.
            let z = 1.0 - (2.0 * i as f32 + 1.0) / directions as f32;
            let (s, c) = (i as f32 * 2.399_963_2).sin_cos();
            let r = (1.0 - z * z).sqrt();
            farthest(&Vector3::new(r * c, r * s, z))
        })
        .collect();
    for _ in 0..3 {
        points.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        points.dedup();
        let cloud: Vec<Point3<f32>> = points.iter().map(|p| Point3::from(*p)).collect();
        let Ok((corners, faces)) = try_convex_hull(&cloud) else { return cloud };
        let before = points.len();
        for face in faces {
            let [a, b, c] = face.map(|i| corners[i as usize]);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
            points.extend(
                farthest(&normal).filter(|v| reach(v, &normal) > a.coords.dot(&normal) + HULL_TOLERANCE),
            );
        }
        if points.len() == before {
            return corners;
        }
    }
    let cloud: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
    try_convex_hull(&cloud).map_or(cloud, |(corners, _)| corners)
}
