use super::*;

/// A tetrahedron whose corners lie at up to `size`.
fn tetrahedron(size: f32) -> String {
    format!("v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
}

fn folder(files: &[(&str, String)]) -> (tempfile::TempDir, SynthConfig) {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let config = SynthConfig { mesh_folder: folder.path().to_owned(), ..SynthConfig::default() };
    (folder, config)
}

#[test]
fn google_and_shapenet_folders_have_one_mesh_per_object_in_megapose_size() {
    let files = [
        ("Cup/meshes/model.obj", tetrahedron(0.09)),
        ("Cup/meshes/collision.obj", tetrahedron(0.08)),
        ("Mug/meshes/model.obj", tetrahedron(0.1)),
    ];
    let (_folder, config) = folder(&files);
    let meshes = MeshFolder::open(&config).unwrap();
    let names: Vec<String> = (0..2).map(|i| meshes.name(meshes.file(i))).collect();
    assert_eq!((names, meshes.files.len()), (vec!["Cup".to_owned(), "Mug".to_owned()], 2));
    let own = meshes.load(meshes.file(0), &config, 0.2).unwrap();
    assert!((own.diameter() - 0.09 * 2f32.sqrt()).abs() < 1e-6, "metres stay");
    let megapose = SynthConfig { mesh_size: MeshSize::MegaPose, ..config.clone() };
    let unit = meshes.load(meshes.file(0), &megapose, 0.2).unwrap();
    let radius = unit.vertices.iter().map(|v| Vector3::from(*v).norm()).fold(0.0, f32::max);
    assert!((radius - 0.1).abs() < 1e-6);
    let plain = SynthConfig { mesh_layout: MeshLayout::Plain, ..config };
    assert_eq!(MeshFolder::open(&plain).unwrap().files.len(), 3);

    let (_folder, config) = folder(&[("0294/ab1/models/model_normalized.obj", tetrahedron(0.7))]);
    let shapenet = SynthConfig { mesh_size: MeshSize::MegaPose, ..config };
    let meshes = MeshFolder::open(&shapenet).unwrap();
    assert_eq!(meshes.name(meshes.file(5)), "0294_ab1");
    let mesh = meshes.load(meshes.file(0), &shapenet, 0.2).unwrap();
    assert!((mesh.diameter() - 0.07 * 2f32.sqrt()).abs() < 1e-6);
    let gso = SynthConfig { mesh_layout: MeshLayout::Gso, ..shapenet };
    assert!(MeshFolder::open(&gso).unwrap_err().to_string().contains("no ply, obj"));
}

#[test]
fn unusable_meshes_are_replaced_and_counted() {
    let nan = tetrahedron(0.1).replace("v 0.1 0 0", "v nan 0 0");
    let files = [
        ("good.obj", tetrahedron(0.1)),
        ("empty.obj", String::new()),
        ("nan.obj", nan),
        ("huge unit.obj", tetrahedron(100.0)),
        ("far.obj", tetrahedron(1e30)),
        ("text.glb", "glTF, says the name".to_owned()),
        ("count.stl", "\u{7f}".repeat(134)),
    ];
    let (_folder, config) = folder(&files);
    let config = SynthConfig { mesh_share: 1.0, texture_size: 32, ..config };
    let library = crate::object::ObjectLibrary::new(&config).unwrap();
    let objects: Vec<_> = (1..=7).map(|id| library.build(id)).collect();
    assert_eq!(library.replaced(), 5);
    library.check_meshes().unwrap();
    let named = |name: &str| objects.iter().find(|o| o.name.starts_with(name)).unwrap();
    assert!((named("good").mesh.diameter() - 0.1 * 2f32.sqrt()).abs() < 1e-6);
    let [low, high] = config.diameter;
    assert!((low..=high).contains(&named("huge unit").mesh.diameter()));
}

#[test]
fn a_folder_without_any_usable_mesh_is_an_error() {
    let broken = [("a.obj", tetrahedron(1e30)), ("b.glb", "{}".to_owned())];
    let (place, config) = folder(&broken);
    let config = SynthConfig { mesh_share: 1.0, texture_size: 32, ..config };
    let get = |config: &SynthConfig| crate::object_cache::ObjectCache::new(config)?.get(&[1, 2], &|| {});
    let message = get(&config).unwrap_err().to_string();
    assert!(message.contains("none of 2 meshes can be used; the first:"), "{message}");
    assert!(message.contains("a.obj: mesh extends over 1e30 m"), "{message}");
    // Objects 1 and 2 have b.glb and c.glb; the usable mesh is one that no object has yet.
    std::fs::write(place.path().join("a.obj"), tetrahedron(0.1)).unwrap();
    std::fs::write(place.path().join("c.glb"), "{}").unwrap();
    let objects = get(&config).unwrap();
    assert!(objects.iter().all(|o| !o.name.starts_with("a_")), "{:?}", objects[0].name);
}

#[cfg(unix)]
#[test]
fn links_back_to_a_folder_above_are_not_followed() {
    let (place, config) = folder(&[("a/one.obj", tetrahedron(0.1)), ("b/two.obj", tetrahedron(0.1))]);
    for link in ["a/up", "b/up"] {
        std::os::unix::fs::symlink(place.path(), place.path().join(link)).unwrap();
    }
    assert_eq!(MeshFolder::open(&config).unwrap().files.len(), 2);
}

#[test]
fn flat_thin_and_torn_meshes_can_be_dropped() {
    use rand::{Rng, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut soup = |sides: [f32; 3], faces: usize| {
        let mut text = String::new();
        for _ in 0..3 * faces {
            let [x, y, z] = sides.map(|side| side * rng.random_range(0.0f32..1.0));
            text += &format!("v {x} {y} {z}\n");
        }
        (0..faces).for_each(|f| text += &format!("f {} {} {}\n", 3 * f + 1, 3 * f + 2, 3 * f + 3));
        text
    };
    let shapes = [
        ("torn", soup([0.1; 3], 30)),
        ("one face", soup([0.1; 3], 1)),
        ("flat", soup([0.1, 0.1, 0.0], 20)),
        ("thin", soup([0.1, 0.1, 1e-7], 20)),
        ("needle", soup([0.1, 1e-7, 1e-7], 20)),
        ("tiny", soup([2e-6; 3], 20)),
        ("huge", soup([900.0; 3], 20)),
        ("long", soup([900.0, 1e-5, 0.0], 20)),
    ];
    let files: Vec<(String, String)> = shapes.map(|(name, text)| (format!("{name}.obj"), text)).into();
    let files: Vec<(&str, String)> = files.iter().map(|(name, text)| (name.as_str(), text.clone())).collect();
    let (_folder, config) = folder(&files);
    for mesh_size in [MeshSize::Own, MeshSize::MegaPose] {
        let config = SynthConfig { mesh_share: 1.0, texture_size: 32, mesh_size, ..config.clone() };
        let library = crate::object::ObjectLibrary::new(&config).unwrap();
        let objects: Vec<_> = (1..=8).map(|id| library.build(id)).collect();
        let objects: Vec<_> = objects.iter().collect();
        for seed in 0..4 {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let place = crate::place::Place::Table;
            let poses = crate::physics::drop_objects(&objects, &place, false, &mut rng);
            for pose in poses.iter().flatten() {
                assert!(pose.translation.iter().all(|x| x.is_finite()), "{pose:?}");
            }
            assert_eq!(poses.len(), 8);
            assert!(poses.iter().flatten().count() >= 1, "the torn one, at least, has a hull");
        }
    }
}
