use std::{collections::BTreeMap, path::Path};

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
    formats::megapose::ShardDataset,
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

/// Every file below a folder.
fn contents(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(
                    path.strip_prefix(root).unwrap().display().to_string(),
                    std::fs::read(&path).unwrap(),
                );
            }
        }
    }
    files
}

#[test]
fn same_bytes_with_any_threads_and_after_an_interruption() {
    let config = small();
    let [a, b] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let run = |threads: usize, work: &(dyn Fn() + Sync)| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work);
    };
    run(1, &|| {
        generate(&config, a.path(), &|_| {}).unwrap();
    });
    run(3, &|| {
        // Shard 1 exists, shard 0 and 2 do not: what a killed run of several machines leaves.
        generate_shards(&config, b.path(), 1..2, &|_| {}).unwrap();
        let summary = generate(&config, b.path(), &|_| {}).unwrap();
        assert_eq!((summary.shards_written, summary.shards_kept, summary.images_written), (2, 1, 6));
    });
    let (a_files, b_files) = (contents(a.path()), contents(b.path()));
    assert_eq!(a_files.keys().collect::<Vec<_>>(), b_files.keys().collect::<Vec<_>>());
    for (name, bytes) in &a_files {
        assert!(b_files[name] == *bytes, "{name} differs");
    }
    let again = generate(&config, a.path(), &|_| {}).unwrap();
    assert_eq!(again, Summary { shards_written: 0, shards_kept: 3, images_written: 0 });
    assert!(contents(a.path()) == a_files);
    let other = SynthConfig { seed: 12, ..config };
    let error = generate(&other, a.path(), &|_| {}).unwrap_err().to_string();
    assert!(error.contains("seed is 11 there and 12 here"), "{error}");
}

#[test]
fn a_generated_set_is_read_back_with_metric_poses() {
    let config = SynthConfig { width: 320, height: 240, images: 4, ..small() };
    let folder = tempfile::tempdir().unwrap();
    generate(&config, folder.path(), &|_| {}).unwrap();
    let dataset = ShardDataset::open(folder.path()).unwrap();
    assert_eq!((dataset.image_keys().len(), dataset.problems().len()), (4, 0));
    assert!(dataset.instances().len() >= 4, "{} valid instances", dataset.instances().len());
    let mut errors = Vec::new();
    for reference in dataset.instances() {
        let image = dataset.load(reference.image).unwrap();
        let instance = &image.instances[reference.instance as usize];
        assert_eq!(instance.obj_id, reference.obj_id);
        let path = folder.path().join(format!("models/obj_{:06}.ply", instance.obj_id));
        let mesh = crate::mesh::load(&path, 0.001).unwrap();
        let (t, k) = (instance.t_camera_object.inverse(), &image.frame.intrinsics);
        let vertices: Vec<Point3<f32>> = mesh.vertices.iter().map(|v| Point3::from(*v)).collect();
        let surface = TriMesh::new(vertices, mesh.faces.clone()).unwrap();
        for (col, row) in instance.mask_visib.pixels().step_by(11) {
            let z = image.frame.depth.get(col, row);
            if z > 0.0 {
                let p = t.transform(&k.back_project(col.into(), row.into(), z.into())).cast::<f32>();
                let ray = parry3d::query::PointQuery::distance_to_local_point(&surface, &p, false);
                errors.push(ray.abs());
            }
        }
    }
    errors.sort_by(f32::total_cmp);
    let (median, p90) = (errors[errors.len() / 2], errors[errors.len() * 9 / 10]);
    assert!(
        median < 0.002 && p90 < 0.012,
        "measured points lie {median} m (median), {p90} m (90 %) off the models"
    );
    assert!(Vector3::from(mesh_size(folder.path())).norm() < 0.5);
}

fn mesh_size(folder: &Path) -> [f32; 3] {
    crate::mesh::load(&folder.join("models/obj_000001.ply"), 0.001).unwrap().bounds().size()
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
fn a_bop_set_has_targets_with_references_from_other_scenes() {
    let config =
        SynthConfig { images: 24, views_per_scene: 4, objects: 4, width: 320, height: 240, ..small() };
    let folder = tempfile::tempdir().unwrap();
    let summary = generate_bop(&config, folder.path(), &|_| {}).unwrap();
    assert_eq!((summary.shards_written, summary.images_written), (6, 24));
    let before = contents(folder.path());
    let again = generate_bop(&config, folder.path(), &|_| {}).unwrap();
    assert_eq!((again.shards_kept, again.images_written), (6, 0));
    assert!(contents(folder.path()) == before);
    let list = folder.path().join("test_ref_targets_crossscene_rot50.json");
    let references = crate::formats::targets::read_reference_targets(&list).unwrap();
    let split = crate::formats::BopDataset::open(folder.path()).unwrap().split("test").unwrap();
    assert!(references.len() >= 10, "{} targets", references.len());
    for target in &references {
        assert_ne!(target.scene_id, target.ref_scene_id);
        let image = split.load(target.ref_scene_id, target.ref_im_id).unwrap();
        let reference = image.instances.iter().find(|i| i.obj_id == target.obj_id).unwrap();
        assert!(reference.visib_fract >= 0.7 && target.rot_deg.unwrap() <= 50.0);
    }
}
