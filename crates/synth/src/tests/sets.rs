//! Whole sets in folders.

use std::{collections::BTreeMap, path::Path};

use nalgebra::{Point3, Vector3};
use parry3d::shape::TriMesh;
use unopose_core::{config::SynthConfig, frame::Mask};
use unopose_dataset::{formats::megapose::ShardDataset, render::depth::render_depth};

use super::{super::*, LeftOpen, ObjectLibrary, small};

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
        let error = generate_shards(&config, b.path(), 0..u32::MAX, &|_| {}).unwrap_err().to_string();
        assert!(error.contains("shards 0..4294967295 of a set of 3, expected 0..3"), "{error}");
        let summary = generate(&config, b.path(), &|_| {}).unwrap();
        assert_eq!((summary.shards_written, summary.shards_kept, summary.images_written), (2, 1, 6));
    });
    let (a_files, b_files) = (contents(a.path()), contents(b.path()));
    assert_eq!(a_files.keys().collect::<Vec<_>>(), b_files.keys().collect::<Vec<_>>());
    for (name, bytes) in &a_files {
        assert!(b_files[name] == *bytes, "{name} differs");
    }
    let again = generate(&config, a.path(), &|_| {}).unwrap();
    assert_eq!(again, GenerationSummary { shards_kept: 3, ..GenerationSummary::default() });
    assert!(contents(a.path()) == a_files);
    let other = SynthConfig { seed: 12, ..config.clone() };
    let error = generate(&other, a.path(), &|_| {}).unwrap_err().to_string();
    assert!(error.contains("seed is 11 there and 12 here"), "{error}");
    let error = generate_bop(&config, a.path(), &|_| {}).unwrap_err().to_string();
    assert!(error.contains("it has train_pbr_web/"), "{error}");
    std::fs::write(a.path().join("notes.txt"), "mine").unwrap();
    remove_generated(&config, a.path()).unwrap();
    assert_eq!(contents(a.path()).keys().collect::<Vec<_>>(), ["notes.txt"]);
    std::fs::create_dir_all(a.path().join("train_pbr_web")).unwrap();
    std::fs::write(a.path().join("train_pbr_web/shard-000000.tar"), "foreign").unwrap();
    let error = generate(&config, a.path(), &|_| {}).unwrap_err().to_string();
    assert!(error.contains("train_pbr_web/ without generation.json"), "{error}");
}

#[test]
fn a_generated_set_is_read_back_with_metric_poses() {
    let config = SynthConfig { width: 320, height: 240, images: 6, ..small() };
    let folder = tempfile::tempdir().unwrap();
    generate(&config, folder.path(), &|_| {}).unwrap();
    let dataset = ShardDataset::open(folder.path()).unwrap();
    assert_eq!((dataset.image_keys().len(), dataset.problems().len()), (6, 0));
    assert!(dataset.instances().len() >= 4, "{} valid instances", dataset.instances().len());
    let mut errors = Vec::new();
    for reference in dataset.instances() {
        let image = dataset.load(reference.image).unwrap();
        let instance = &image.instances[reference.instance as usize];
        assert_eq!(instance.obj_id, reference.obj_id);
        let path = folder.path().join(format!("models/obj_{:06}.ply", instance.obj_id));
        let mesh = unopose_dataset::mesh::load(&path, 0.001).unwrap();
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

/// Every shard: the pose of every instance puts the vertices of its written model on its silhouette, and the drawn model
/// covers it.
#[test]
fn poses_of_every_shard_put_the_models_on_their_pixels() {
    let config = SynthConfig {
        width: 320,
        height: 240,
        images: 6,
        images_per_shard: 2,
        write_models: true,
        ..small()
    };
    let folder = tempfile::tempdir().unwrap();
    generate(&config, folder.path(), &|_| {}).unwrap();
    let dataset = ShardDataset::open(folder.path()).unwrap();
    let (mut instances, mut lowest) = (0, 1f64);
    for image in 0..6 {
        let (annotated, records) = (dataset.load(image).unwrap(), dataset.records(image).unwrap());
        let frame = &annotated.frame;
        for (gt, mask) in records.gt.iter().zip(&records.mask) {
            let mask = mask.decode().unwrap();
            if mask.count() < 200 {
                continue;
            }
            let pose = gt.pose("gt").unwrap();
            let path = folder.path().join(format!("models/obj_{:06}.ply", gt.obj_id));
            let mesh = unopose_dataset::mesh::load(&path, 0.001).unwrap();
            let drawn = render_depth(&mesh, &pose, &frame.intrinsics, 320, 240).to_depth_map(320, 240);
            let data = drawn.data.iter().map(|z| *z > 0.0).collect();
            lowest = lowest.min(mask.iou(&Mask { width: 320, height: 240, data }));
            let in_image = |p: &[f32; 3]| {
                let uv = frame.intrinsics.project(&pose.transform(&Point3::from(*p).cast()))?;
                let (col, row) = (uv.x.round(), uv.y.round());
                let inside = (1.0..319.0).contains(&col) && (1.0..239.0).contains(&row);
                inside.then_some((col as u32, row as u32))
            };
            let near = |&(col, row): &(u32, u32)| {
                (row - 1..=row + 1).any(|r| (col - 1..=col + 1).any(|c| mask.get(c, r)))
            };
            let seen: Vec<(u32, u32)> = mesh.vertices.iter().filter_map(in_image).collect();
            let hits = seen.iter().filter(|at| near(at)).count();
            assert!(hits as f64 >= 0.98 * seen.len() as f64, "{hits} of {} vertices", seen.len());
            instances += 1;
        }
    }
    assert!(instances >= 12, "{instances} instances");
    assert!(lowest > 0.98, "lowest IoU of mask and drawn model {lowest}");
}

fn mesh_size(folder: &Path) -> [f32; 3] {
    unopose_dataset::mesh::load(&folder.join("models/obj_000001.ply"), 0.001).unwrap().bounds().size()
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
    let references = unopose_dataset::formats::targets::read_reference_targets(&list).unwrap();
    let split = unopose_dataset::formats::BopDataset::open(folder.path()).unwrap().split("test").unwrap();
    assert!(references.len() >= 10, "{} targets", references.len());
    for target in &references {
        assert_ne!(target.scene_id, target.ref_scene_id);
        let image = split.load(target.ref_scene_id, target.ref_im_id).unwrap();
        let reference = image.instances.iter().find(|i| i.obj_id == target.obj_id).unwrap();
        assert!(reference.visib_fract >= 0.7 && target.rot_deg.unwrap() <= 50.0);
    }
    // Overlap falls with the angle; one reference per object is one image per object; bins hold what they say.
    let list = |name: &str| {
        let file = folder.path().join(format!("test_ref_targets_{name}.json"));
        if file.is_file() {
            unopose_dataset::formats::targets::read_reference_targets(&file).unwrap()
        } else {
            Vec::new()
        }
    };
    let mean_overlap = |l: &[unopose_dataset::formats::ReferenceTarget]| {
        l.iter().map(|t| t.overlap.unwrap()).sum::<f64>() / l.len() as f64
    };
    let mut far = Vec::new();
    for bin in 0..9 {
        let entries = list(&format!("crossscene_rot{:02}-{:02}", bin * 10, bin * 10 + 10));
        let inside =
            |t: &unopose_dataset::formats::ReferenceTarget| (t.rot_deg.unwrap() / 10.0) as usize == bin;
        assert!(entries.iter().all(inside), "bin {bin}");
        far.extend(entries.into_iter().filter(|_| bin >= 7));
    }
    assert_eq!(list("crossscene_rot90").len(), references.len());
    assert!(mean_overlap(&references) > mean_overlap(&far) + 0.05, "{}", mean_overlap(&far));
    let one: std::collections::BTreeSet<_> =
        list("one_per_object").iter().map(|t| (t.obj_id, t.ref_scene_id, t.ref_im_id)).collect();
    assert!(one.len() <= 4 && !one.is_empty(), "{one:?}");
    let eight: std::collections::BTreeSet<_> =
        list("8_per_object").iter().map(|t| (t.obj_id, t.ref_scene_id, t.ref_im_id)).collect();
    assert!(eight.len() > one.len() && eight.len() <= 32, "{}", eight.len());
    assert_eq!(findings(folder.path()), Vec::<String>::new());
    let info = split.scene_folder(split.scene_ids()[0]).unwrap().join("scene_gt_info.json");
    let text = std::fs::read_to_string(&info).unwrap();
    std::fs::write(&info, text.replacen("\"0\":", "\"99\":", 1)).unwrap();
    let found = findings(folder.path());
    let expected = "scene_gt_info.json: 1 annotated images have no entry";
    assert!(found.len() == 1 && found[0].contains(expected), "{found:?}");
}

#[test]
fn shards_say_which_objects_only_the_print_tells_apart() {
    let config = SynthConfig { printed: 0.5, objects: 6, images: 6, ..small() };
    let folder = tempfile::tempdir().unwrap();
    generate(&config, folder.path(), &|_| {}).unwrap();
    let library = ObjectLibrary::new(&config).unwrap();
    let left_open = |id: &u32| library.build(*id).left_open != LeftOpen::None;
    let expected: Vec<u64> = (1..=6).filter(left_open).map(u64::from).collect();
    let text = std::fs::read_to_string(folder.path().join("models/print_decides.json")).unwrap();
    let listed: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    let ids: Vec<u64> = listed.iter().map(|entry| entry["obj_id"].as_u64().unwrap()).collect();
    assert_eq!(ids, expected);
    assert!((1..6).contains(&ids.len()), "{ids:?}");
}

fn findings(folder: &Path) -> Vec<String> {
    let report = check_dataset(folder, 4, &|_, _| {}).unwrap();
    report.findings().map(|finding| format!("{}: {}", finding.place, finding.what)).collect()
}

#[test]
fn a_folder_that_is_being_filled_is_refused_and_not_emptied() {
    let (config, folder) = (small(), tempfile::tempdir().unwrap());
    let out = folder.path();
    generate(&config, out, &|_| {}).unwrap();
    let before = contents(out);
    // Another set of shards is being made there.
    let lock = unopose_core::folder_lock::FolderLock::shared(out).unwrap();
    generate_shards(&config, out, 0..1, &|_| {}).unwrap();
    let other = SynthConfig { seed: 12, ..config.clone() };
    let refusals = [
        generate(&config, out, &|_| {}).map(|_| ()),
        generate_bop(&config, out, &|_| {}).map(|_| ()),
        remove_generated(&other, out),
    ];
    for refused in refusals {
        let error = refused.unwrap_err().to_string();
        let owner = format!("in use by process {} on ", std::process::id());
        assert!(error.contains(&owner), "{error}");
    }
    drop(lock);
    // Nor is a set removed for one that cannot be made.
    let impossible = SynthConfig { images: 0, ..config.clone() };
    assert!(remove_generated(&impossible, out).unwrap_err().to_string().contains("synth.images is 0"));
    generate(&config, out, &|_| {}).unwrap();
    assert!(contents(out) == before);
}

#[test]
fn a_stopped_generation_goes_on_and_leaves_nothing_half_written() {
    let config = small();
    let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    generate(&config, whole.path(), &|_| {}).unwrap();
    let stop = |progress: GenerationProgress| {
        if progress.stage == Stage::Images && progress.done > config.images_per_shard {
            progress.stop();
        }
    };
    let error = generate(&config, parts.path(), &stop).unwrap_err();
    assert!(matches!(error, SynthError::Stopped), "{error}");
    let shards = |root: &Path| contents(root).keys().filter(|name| name.ends_with(".tar")).count();
    assert!((1..shards(whole.path())).contains(&shards(parts.path())), "{}", shards(parts.path()));
    // What a kill leaves besides.
    for name in [".part-a", "models/.part-b", "train_pbr_web/.part-c"] {
        std::fs::write(parts.path().join(name), "half").unwrap();
    }
    let found = check_dataset(parts.path(), 1, &|_, _| {}).unwrap();
    assert_eq!(found.findings().filter(|f| f.what.starts_with("left behind")).count(), 3);
    generate(&config, parts.path(), &|_| {}).unwrap();
    assert!(contents(parts.path()) == contents(whole.path()));
}
