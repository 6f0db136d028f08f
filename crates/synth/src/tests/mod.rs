mod scenes;
mod sets;

use nalgebra::{Point3, Vector3};
use parry3d::{query::RayCast, shape::TriMesh};
use unopose_core::{config::SynthConfig, frame::Mask};
use unopose_dataset::{
    formats::ObjectSymmetries,
    render::{Camera, SceneRenderer, instance_views},
};

use super::{
    object::{LeftOpen, ObjectLibrary, SynthObject},
    random::{Domain, stream},
    scene::{self, Arrangement, SceneAssets},
    *,
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

fn assets(config: &SynthConfig) -> SceneAssets {
    object_cache::ObjectCache::new(config).unwrap().scene_assets(config, 0).unwrap()
}

/// A few scenes with one view each.
fn views(config: &SynthConfig, assets: &SceneAssets, count: u64) -> Vec<(Arrangement, Camera)> {
    (0..count)
        .map(|k| {
            let mut rng = stream(config.seed, Domain::Scene, k);
            let arrangement = scene::arrange(config, assets, &mut rng);
            let camera = arrangement.camera(config, k as usize, count as usize, &mut rng);
            (arrangement, camera)
        })
        .collect()
}

#[test]
fn depth_inside_visible_masks_is_where_an_independent_ray_meets_the_mesh() {
    let config = SynthConfig { width: 320, height: 240, ..small() };
    let assets = assets(&config);
    let (mut checked, mut off, mut worst) = (0, 0, 0f32);
    for (arrangement, camera) in views(&config, &assets, 4) {
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
    let assets = assets(&config);
    for (arrangement, camera) in views(&config, &assets, 4) {
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
fn only_the_print_tells_how_a_package_is_turned() {
    let plain = SynthConfig { printed: 0.0, textureless: 1.0, ..small() };
    let library = |config: &SynthConfig| ObjectLibrary::new(config).unwrap();
    let axis = |object: &SynthObject| !object.symmetries.continuous.is_empty();
    // Every plain body of revolution is symmetric; no package is.
    let plain: Vec<SynthObject> = (1..=32).map(|id| library(&plain).build(id)).collect();
    assert!(plain.iter().any(axis));
    assert!(plain.iter().all(|object| !axis(object) || object.left_open == LeftOpen::None));
    let printed = SynthConfig { printed: 1.0, ..small() };
    let printed: Vec<SynthObject> = (1..=24).map(|id| library(&printed).build(id)).collect();
    let count = |kind| printed.iter().filter(|object| object.left_open == kind).count();
    assert!(printed.iter().all(|o| o.symmetries == ObjectSymmetries::default()));
    assert!(count(LeftOpen::Axis) >= 10 && count(LeftOpen::Flip) >= 4, "{:?}", count(LeftOpen::Flip));
}

#[test]
fn a_folder_without_photographs_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.txt"), "no picture").unwrap();
    let config = SynthConfig { printed: 1.0, texture_folder: folder.path().into(), ..small() };
    let message = ObjectLibrary::new(&config).unwrap_err().to_string();
    assert!(message.contains("no jpg or png files found"), "{message}");
    // One that is none is named in the log and replaced.
    std::fs::write(folder.path().join("broken.jpg"), "no picture").unwrap();
    assert!(ObjectLibrary::new(&config).unwrap().build(1).mesh.texture.is_some());
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

#[test]
fn a_shape_that_cannot_be_decomposed_at_first_is_decomposed_more_finely() {
    // The library's hull of some of its voxels fails at 24 voxels a side.
    let config =
        SynthConfig { seed: 95, objects: 800, printed: 0.6, texture_size: 32, ..SynthConfig::default() };
    let object = ObjectLibrary::new(&config).unwrap().build(1089);
    assert!((2..=16).contains(&object.parts.len()), "{}: {} parts", object.name, object.parts.len());
    // Together the parts reach as far as the hull in every direction.
    let mut rng = stream(1, Domain::Scene, 0);
    for _ in 0..200 {
        let d = random::Draw::unit_vector(&mut rng);
        let reach = |p: &Point3<f32>| p.coords.dot(&d);
        let hull = object.hull.iter().map(reach).fold(f32::MIN, f32::max);
        let parts = object.parts.iter().flatten().map(reach).fold(f32::MIN, f32::max);
        assert!((hull - parts).abs() < 0.0015, "{} mm between them", 1000.0 * (hull - parts));
    }
}

#[test]
fn gathered_light_darkens_what_is_enclosed_and_keeps_open_ground() {
    let config = SynthConfig { distractors: [0, 0], bins: 0.0, shelves: 0.0, tumbling: 0.0, ..small() };
    let assets = assets(&config);
    let (arrangement, camera) = views(&config, &assets, 1).remove(0);
    let mut scene = arrangement.scene;
    scene.lights.clear();
    (scene.sky, scene.ground) = ([1.0; 3], [1.0; 3]);
    // Without gloss a surface sends back its albedo and the 4 % of every dielectric.
    scene.room.blocks.iter_mut().for_each(|b| b.surface.finish.roughness = 1.0);
    let view = SceneRenderer::new(&scene).with_indirect_rays(48).render(&camera, 1);
    // White surroundings of radiance 1 everywhere: what is open sends back its own reflectance, nothing sends more.
    let ratios: Vec<(f32, bool)> = (0..view.ids.len())
        .filter(|&i| view.ids[i] == 0 && view.albedo[i] > 0.02 && view.depth.data[i] < 2.0)
        .map(|i| {
            let [r, g, b] = view.radiance[i];
            let near = (0..view.ids.len()).any(|k| {
                let (dx, dy) = ((k % 160).abs_diff(i % 160), (k / 160).abs_diff(i / 160));
                view.ids[k] > 0 && dx.max(dy) < 2
            });
            ((0.2126 * r + 0.7152 * g + 0.0722 * b) / (view.albedo[i] + 0.04), near)
        })
        .collect();
    let mean = |near: bool| {
        let of: Vec<f32> = ratios.iter().filter(|r| r.1 == near).map(|r| r.0).collect();
        of.iter().sum::<f32>() / of.len() as f32
    };
    let (open, contact) = (mean(false), mean(true));
    assert!((0.8..1.02).contains(&open), "open table: {open}");
    assert!(contact < open - 0.03, "beside objects {contact}, open {open}");
}
