mod sets;

use nalgebra::{Point3, Vector3};
use parry3d::{query::RayCast, shape::TriMesh};

use super::{
    generate::pool_of,
    object::{ObjectLibrary, SynthObject},
    random::{Domain, stream},
    scene::{self, Arrangement},
    *,
};
use crate::{
    config::SynthConfig,
    frame::Mask,
    render::{Camera, SceneRenderer, instance_views},
};

fn small() -> SynthConfig {
    SynthConfig {
        seed: 11,
        images: 10,
        images_per_shard: 4,
        views_per_scene: 2,
        objects: 16,
        width: 160,
        height: 120,
        supersampling: 1,
        texture_size: 48,
        ..SynthConfig::default()
    }
}

fn pool(config: &SynthConfig) -> Vec<SynthObject> {
    let library = ObjectLibrary::new(config).unwrap();
    pool_of(config, 0).into_iter().map(|id| library.build(id)).collect()
}

/// A few scenes with one view each.
fn views(config: &SynthConfig, pool: &[SynthObject], count: u64) -> Vec<(Arrangement, Camera)> {
    (0..count)
        .map(|k| {
            let mut rng = stream(config.seed, Domain::Scene, k);
            let arrangement = scene::arrange(config, pool, &mut rng);
            let camera = arrangement.camera(config, k as usize, count as usize, &mut rng);
            (arrangement, camera)
        })
        .collect()
}

#[test]
fn depth_inside_visible_masks_is_where_an_independent_ray_meets_the_mesh() {
    let config = SynthConfig { width: 320, height: 240, ..small() };
    let pool = pool(&config);
    let (mut checked, mut off, mut worst) = (0, 0, 0f32);
    for (arrangement, camera) in views(&config, &pool, 4) {
        let scene = &arrangement.scene;
        let view = SceneRenderer::new(scene).render(&camera, 1);
        let meshes: Vec<TriMesh> = scene
            .objects
            .iter()
            .map(|o| {
                let t = camera.t_camera_world * o.t_world_object;
                let vertices = o.mesh.vertices.iter().map(|v| Point3::from(t.transform_f32(v))).collect();
                TriMesh::new(vertices, o.mesh.faces.clone()).unwrap()
            })
            .collect();
        for (i, &id) in view.ids.iter().enumerate().filter(|(i, id)| **id > 0 && i % 7 == 0) {
            let (col, row) = (i as u32 % camera.width, i as u32 / camera.width);
            let direction = camera.intrinsics.back_project(col.into(), row.into(), 1.0).coords.cast::<f32>();
            let ray = parry3d::query::Ray::new(Point3::origin(), direction);
            let hit = |m: &TriMesh| m.cast_local_ray(&ray, 10.0, false).unwrap_or(f32::MAX);
            let own = hit(&meshes[usize::from(id) - 1]);
            let nearest = meshes.iter().map(hit).fold(f32::MAX, f32::min);
            checked += 1;
            let error = (own - view.depth.data[i]).abs();
            // A ray through an edge may pass on either side of it.
            if error > 1e-4 || own > nearest + 1e-4 {
                off += 1;
            } else {
                worst = worst.max(error);
            }
        }
    }
    assert!(checked > 1000, "{checked} pixels");
    assert!(off * 500 <= checked, "{off} of {checked} pixels differ by more than 0.1 mm");
    assert!(worst < 1e-4, "{worst} m");
}

#[test]
fn vertices_project_into_the_silhouette_and_visibility_follows_from_the_masks() {
    let config = small();
    let pool = pool(&config);
    for (arrangement, camera) in views(&config, &pool, 4) {
        let scene = &arrangement.scene;
        let view = SceneRenderer::new(scene).render(&camera, 1);
        for (object, instance) in scene.objects.iter().zip(instance_views(&scene.objects, &camera, &view.ids))
        {
            let t = camera.t_camera_world * object.t_world_object;
            let near = |mask: &Mask, u: i64, v: i64| {
                (-1..=1).any(|dy| {
                    (-1..=1).any(|dx| {
                        let (x, y) = (u + dx, v + dy);
                        let inside = (0..i64::from(mask.width)).contains(&x)
                            && (0..i64::from(mask.height)).contains(&y);
                        inside && mask.get(x as u32, y as u32)
                    })
                })
            };
            let (mut inside, mut in_image) = (0usize, 0usize);
            for v in &object.mesh.vertices {
                let p = t.transform(&Point3::from(*v).cast());
                let Some(uv) = camera.intrinsics.project(&p) else { continue };
                let (u, v) = (uv.x.round() as i64, uv.y.round() as i64);
                if (1..i64::from(config.width) - 1).contains(&u)
                    && (1..i64::from(config.height) - 1).contains(&v)
                {
                    in_image += 1;
                    inside += usize::from(near(&instance.mask, u, v));
                }
            }
            // Slivers thinner than a pixel may be missed by every pixel centre.
            assert!(
                inside as f64 >= 0.98 * in_image as f64,
                "{inside} of {in_image} vertices in the silhouette"
            );
            let visible = instance.mask_visib.count();
            assert_eq!(visible, instance.px_count_visib as usize);
            assert!(instance.mask.count() <= instance.px_count_all as usize);
            let both =
                instance.mask.data.iter().zip(&instance.mask_visib.data).filter(|(a, b)| **a && **b).count();
            assert_eq!(both, visible, "visible pixels outside the silhouette");
            if instance.px_count_all > 0 {
                let fract = visible as f64 / f64::from(instance.px_count_all);
                assert!((fract - instance.visib_fract).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn settled_objects_rest_on_the_table() {
    let config = SynthConfig { tumbling: 0.0, ..small() };
    let pool = pool(&config);
    let (mut objects, mut deep, mut floating) = (0, 0, 0);
    for (arrangement, _) in views(&config, &pool, 6) {
        let lowest: Vec<f64> = arrangement
            .scene
            .objects
            .iter()
            .map(|o| {
                let height = |v: &[f32; 3]| f64::from(o.t_world_object.transform_f32(v)[2]);
                o.mesh.vertices.iter().map(height).fold(f64::MAX, f64::min)
            })
            .collect();
        objects += lowest.len();
        deep += lowest.iter().filter(|z| **z < -0.002).count();
        // Some lie on others, but not all.
        floating += usize::from(lowest.iter().all(|z| *z > 0.003));
    }
    assert!(objects > 15, "{objects}");
    assert_eq!((deep, floating), (0, 0), "of {objects} objects in 6 scenes");
}

#[test]
fn collision_hulls_enclose_their_meshes() {
    let config = SynthConfig { texture_size: 32, ..small() };
    let library = ObjectLibrary::new(&config).unwrap();
    let mut rng = stream(1, Domain::Scene, 0);
    for id in 1..=64 {
        let object = library.build(id);
        // What the physics really collides with.
        let shape = rapier3d::prelude::ColliderBuilder::convex_hull(&object.hull).unwrap().build();
        let corners = shape.shape().as_convex_polyhedron().unwrap().points().to_vec();
        for _ in 0..200 {
            let d = random::Draw::unit_vector(&mut rng);
            let mesh =
                object.mesh.vertices.iter().map(|v| Vector3::from(*v).dot(&d)).fold(f32::MIN, f32::max);
            let hull = corners.iter().map(|v| v.coords.dot(&d)).fold(f32::MIN, f32::max);
            assert!(mesh - hull < 0.0015, "{}: {} mm outside", object.name, (mesh - hull) * 1000.0);
        }
    }
}
