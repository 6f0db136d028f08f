use nalgebra::Rotation3;
use unopose_dataset::mesh::TriangleMesh;

use super::*;
use crate::random::{Domain, stream};

#[test]
fn every_family_gives_closed_outward_meshes_of_the_asked_size() {
    for family in Family::ALL {
        for index in 0..12 {
            let mut rng = stream(7, Domain::Shape, index);
            let solid = build(family, 0.17, &mut rng);
            let mesh = &solid.mesh;
            mesh.validate().unwrap_or_else(|e| panic!("{family:?} {index}: {e}"));
            assert_eq!(mesh.open_edges(), 0, "{family:?} {index}");
            assert!((mesh.diameter() - 0.17).abs() < 1e-4, "{family:?} {index}: {}", mesh.diameter());
            assert!(mesh.volume() > 1e-6, "{family:?} {index}: volume {}", mesh.volume());
            assert_eq!(solid.parts.len(), mesh.vertices.len());
        }
    }
}

/// Largest distance from a rotated vertex to the nearest vertex, metres.
fn misfit(mesh: &TriangleMesh, rotation: &Rotation3<f32>) -> f32 {
    let nearest = |p: Vector3<f32>| {
        mesh.vertices.iter().map(|v| (Vector3::from(*v) - p).norm()).fold(f32::MAX, f32::min)
    };
    mesh.vertices.iter().step_by(7).map(|v| nearest(rotation * Vector3::from(*v))).fold(0.0, f32::max)
}

#[test]
fn written_symmetries_map_the_shape_onto_itself() {
    let mut checked = 0;
    for family in Family::ALL {
        for index in 0..6 {
            let solid = build(family, 0.2, &mut stream(3, Domain::Shape, index));
            let s = solid.symmetry;
            // Revolved meshes have 48 segments.
            let folds = if s.continuous { 48 } else { s.folds };
            if folds > 1 {
                let turn =
                    Rotation3::from_axis_angle(&Vector3::z_axis(), std::f32::consts::TAU / folds as f32);
                let error = misfit(&solid.mesh, &turn);
                assert!(error < 5e-4, "{family:?} {index} {s:?}: {error}");
                checked += 1;
            }
            if s.flip {
                let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI);
                let error = misfit(&solid.mesh, &turn);
                assert!(error < 5e-4, "{family:?} {index} {s:?}: {error}");
            }
        }
    }
    assert!(checked > 20, "only {checked} symmetric shapes");
}

#[test]
fn another_index_is_another_shape() {
    for family in Family::ALL {
        let [a, b] = [0, 1].map(|i| build(family, 0.2, &mut stream(5, Domain::Shape, i)).mesh);
        assert_ne!(a.vertices, b.vertices, "{family:?}");
        let again = build(family, 0.2, &mut stream(5, Domain::Shape, 0)).mesh;
        assert_eq!(a.vertices, again.vertices);
    }
}
