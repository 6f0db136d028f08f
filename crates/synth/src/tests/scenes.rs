//! How objects lie.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use parry3d::{query::contact, shape::SharedShape};
use unopose_core::config::SynthConfig;
use unopose_dataset::render::PosedMesh;

use super::{super::place::Place, assets, small, views};

fn lowest(object: &PosedMesh) -> f64 {
    let height = |v: &[f32; 3]| f64::from(object.t_world_object.transform_f32(v)[2]);
    object.mesh.vertices.iter().map(height).fold(f64::MAX, f64::min)
}

#[test]
fn settled_objects_rest_on_the_table() {
    let config = SynthConfig { tumbling: 0.0, bins: 0.0, shelves: 0.0, ..small() };
    let assets = assets(&config);
    let (mut objects, mut deep, mut floating) = (0, 0, 0);
    for (arrangement, _) in views(&config, &assets, 6) {
        let lowest: Vec<f64> = arrangement.scene.objects.iter().map(lowest).collect();
        objects += lowest.len();
        deep += lowest.iter().filter(|z| **z < -0.002).count();
        // Some lie on others, but not all.
        floating += usize::from(lowest.iter().all(|z| *z > 0.003));
    }
    assert!(objects > 15, "{objects}");
    assert_eq!((deep, floating), (0, 0), "of {objects} objects in 6 scenes");
}

#[test]
fn objects_stay_in_bins_and_on_shelves_and_out_of_each_other() {
    let config = SynthConfig { tumbling: 0.0, bins: 0.5, shelves: 0.5, ..small() };
    let assets = assets(&config);
    let all: Vec<_> = assets.objects.iter().chain(&assets.distractors).collect();
    let shape = |placed: &PosedMesh| {
        let object = all.iter().find(|o| std::sync::Arc::ptr_eq(&o.mesh, &placed.mesh)).unwrap();
        let parts = if object.parts.is_empty() { vec![object.hull.clone()] } else { object.parts.clone() };
        let parts = parts.iter().filter_map(|p| SharedShape::convex_hull(p));
        SharedShape::compound(parts.map(|s| (Isometry3::identity(), s)).collect())
    };
    let isometry = |placed: &PosedMesh| {
        let t = &placed.t_world_object;
        let rotation = UnitQuaternion::from_matrix(&t.rotation.cast::<f32>());
        Isometry3::from_parts(Translation3::from(t.translation.cast::<f32>()), rotation)
    };
    let (mut bins, mut hidden, mut depths) = (0, 0, Vec::new());
    for (arrangement, camera) in views(&config, &assets, 8) {
        let objects = &arrangement.scene.objects;
        bins += usize::from(matches!(arrangement.place, Place::Bin { .. }));
        hidden += objects.len() - arrangement.obj_ids.len();
        for (i, a) in objects.iter().enumerate() {
            assert!(lowest(a) > -0.002, "{} mm below the floor", lowest(a) * -1000.0);
            if let Some([x, y]) = arrangement.place.area() {
                let at = a.t_world_object.translation;
                assert!(at.x.abs() as f32 <= x && at.y.abs() as f32 <= y, "{at} outside {x} {y}");
            }
            for b in &objects[i + 1..] {
                let met = contact(&isometry(a), &*shape(a).0, &isometry(b), &*shape(b).0, 0.0).unwrap();
                depths.push(met.map_or(0.0, |c| (-c.dist).max(0.0)));
            }
        }
        // Cameras are in front of shelves and above bins.
        let eye: Vector3<f64> = camera.t_camera_world.inverse().translation;
        match arrangement.place {
            Place::Shelf { half, .. } => assert!(eye.y < f64::from(-half[1])),
            Place::Bin { height, .. } => assert!(eye.z > f64::from(height)),
            Place::Table => {}
        }
    }
    depths.sort_by(f32::total_cmp);
    let (worst, pairs) = (depths[depths.len() - 1], depths.len());
    assert!((2..=6).contains(&bins) && hidden > 0, "{bins} bins, {hidden} distractors");
    assert!(worst < 0.002, "{} mm in the worst of {pairs} pairs", worst * 1000.0);
}
