use nalgebra::{Point3, Rotation3, Vector3};

use super::*;

const CAMERA: Intrinsics = Intrinsics { fx: 600.0, fy: 590.0, cx: 79.5, cy: 60.25 };

/// Two-sided grid of `n` x `n` cells bent into a bowl, radius about 8 cm.
fn bowl(n: u32) -> TriangleMesh {
    let coordinate = |i: u32| (i as f32 / n as f32 - 0.5) * 0.16;
    let vertex = |i: u32| {
        let (x, y) = (coordinate(i % (n + 1)), coordinate(i / (n + 1)));
        [x, y, 4.0 * (x * x + y * y)]
    };
    let faces = (0..n * n).flat_map(|cell| {
        let a = cell / n * (n + 1) + cell % n;
        [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
    });
    TriangleMesh {
        vertices: (0..(n + 1) * (n + 1)).map(vertex).collect(),
        faces: faces.collect(),
        ..Default::default()
    }
}

/// Nearest hit of the ray through a pixel centre by solving the plane equations (Moeller and Trumbore).
fn cast(mesh: &TriangleMesh, pose: &Pose, u: u32, v: u32) -> f64 {
    let ray = CAMERA.back_project(f64::from(u), f64::from(v), 1.0).coords;
    let corner = |i: u32| pose.transform(&Point3::from(mesh.vertices[i as usize].map(f64::from))).coords;
    let mut nearest = f64::INFINITY;
    for face in &mesh.faces {
        let [a, b, c] = face.map(corner);
        let (ab, ac) = (b - a, c - a);
        let normal = ray.cross(&ac);
        let determinant = ab.dot(&normal);
        let s = (-a).dot(&normal) / determinant;
        let t = ray.dot(&(-a).cross(&ab)) / determinant;
        let z = ac.dot(&(-a).cross(&ab)) / determinant;
        if s >= -1e-12 && t >= -1e-12 && s + t <= 1.0 + 1e-12 && z > 0.0 {
            nearest = nearest.min(z);
        }
    }
    if nearest.is_finite() { nearest } else { 0.0 }
}

#[test]
fn agrees_with_a_ray_caster() {
    let mesh = bowl(9);
    for seed in 0..6 {
        let angle = Vector3::new(0.4 * f64::from(seed), 0.7, 0.3 * f64::from(seed));
        let rotation = *Rotation3::from_scaled_axis(angle).matrix();
        // The last pose is cut by the image border.
        let pose = Pose::new(rotation, Vector3::new(0.01 * f64::from(seed), -0.02, 0.6));
        let window = render_depth(&mesh, &pose, &CAMERA, 160, 120);
        let mut hits = 0;
        for row in 0..120 {
            for col in 0..160 {
                let (drawn, cast) = (f64::from(window.get(col, row)), cast(&mesh, &pose, col, row));
                assert!((drawn - cast).abs() < 1e-6, "seed {seed}: {drawn} {cast} at ({col}, {row})");
                hits += u32::from(cast > 0.0);
            }
        }
        assert!(hits > 1000, "{hits}");
        assert_eq!(window.to_depth_map(160, 120).data.iter().filter(|&&z| z > 0.0).count(), hits as usize);
    }
}

#[test]
fn a_mesh_around_or_behind_the_camera_is_cut_at_the_near_plane() {
    let mesh = bowl(5);
    let behind = Pose::new(nalgebra::Matrix3::identity(), Vector3::new(0.0, 0.0, -1.0));
    let window = render_depth(&mesh, &behind, &CAMERA, 160, 120);
    assert!(window.depth.is_empty() && window.get(3, 3) == 0.0);

    let around = Pose::new(*Rotation3::from_axis_angle(&Vector3::x_axis(), 1.5).matrix(), Vector3::zeros());
    let window = render_depth(&mesh, &around, &CAMERA, 160, 120);
    for (row, col) in (0..120).step_by(7).flat_map(|r| (0..160).step_by(7).map(move |c| (r, c))) {
        let cast = cast(&mesh, &around, col, row);
        let expected = if cast >= NEAR { cast } else { 0.0 };
        let drawn = f64::from(window.get(col, row));
        assert!(drawn == 0.0 || drawn >= NEAR);
        assert!((drawn - expected).abs() < 1e-6 || cast < NEAR, "{drawn} {expected} at ({col}, {row})");
    }
}

#[test]
fn a_square_covers_the_pixel_centres_inside_it() {
    let square = TriangleMesh {
        vertices: vec![[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [4.0, 3.0, 1.0], [0.0, 3.0, 1.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    };
    let camera = Intrinsics { fx: 1.0, fy: 1.0, cx: 2.5, cy: 1.5 };
    let window = render_depth(&square, &Pose::identity(), &camera, 10, 10);
    // Columns 2.5..6.5 and rows 1.5..4.5.
    assert_eq!(window.bounds, BoundingBox { col_min: 3, row_min: 2, col_max: 7, row_max: 5 });
    assert!(window.depth.iter().all(|&z| z == 1.0));
}
