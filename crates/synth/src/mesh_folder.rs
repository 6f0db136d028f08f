//! Meshes of the user's: any folder, Google Scanned Objects, ShapeNet.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use image::imageops::FilterType;
use nalgebra::Vector3;
use unopose_core::config::{MeshLayout, MeshSize, SynthConfig};
use unopose_dataset::mesh::{self, TriangleMesh, split_by_crease};

use super::SynthError;

/// MegaPose scales the unit sphere (Google Scanned Objects) and ShapeNet's normalised coordinates by this, metres.
const MEGAPOSE_SCALE: f32 = 0.1;
/// Objects outside these diameters were written in another unit, metres.
const PLAUSIBLE: std::ops::RangeInclusive<f32> = 0.02..=0.6;
/// Larger meshes take seconds per scene; they are to be simplified first.
const MOST_FACES: usize = 400_000;
/// STL has neither normals per vertex nor edges; faces meeting at more than this get an edge.
const CREASE_DEG: f32 = 40.0;

/// The mesh files of a folder in a fixed order.
#[derive(Clone, Debug, Default)]
pub(super) struct MeshFolder {
    files: Vec<PathBuf>,
    layout: MeshLayout,
}

impl MeshFolder {
    /// The meshes of `synth.mesh_folder`; none where no folder is configured.
    pub fn open(config: &SynthConfig) -> Result<Self, SynthError> {
        let mut files = Vec::new();
        if config.mesh_folder.as_os_str().is_empty() {
            return Ok(Self::default());
        }
        collect(&config.mesh_folder, &mut Vec::new(), &mut files)?;
        files.sort();
        let of_layout = |layout: MeshLayout| files.iter().filter(|f| belongs(f, layout)).cloned().collect();
        let detected = [MeshLayout::Gso, MeshLayout::ShapeNet]
            .into_iter()
            .find(|&layout| files.iter().any(|f| belongs(f, layout)))
            .unwrap_or(MeshLayout::Plain);
        let layout = if config.mesh_layout == MeshLayout::Detect { detected } else { config.mesh_layout };
        let files: Vec<PathBuf> = of_layout(layout);
        if files.is_empty() {
            return Err(SynthError::NoMeshes { folder: config.mesh_folder.clone() });
        }
        tracing::info!("{}: {} meshes, layout {layout:?}", config.mesh_folder.display(), files.len());
        Ok(Self { files, layout })
    }

    /// Whether no folder is configured.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// All mesh files.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// File number `index`, and around again.
    pub fn file(&self, index: usize) -> &Path {
        &self.files[index % self.files.len()]
    }

    /// Name of the object in a file: its stem, or the folder that Google and ShapeNet name after it.
    pub fn name(&self, file: &Path) -> String {
        let part = |path: Option<&Path>| {
            path.and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
        };
        // NAME/meshes/model.obj, SYNSET/NAME/models/model_normalized.obj
        let object = file.parent().and_then(Path::parent);
        match self.layout {
            MeshLayout::Gso => part(object),
            MeshLayout::ShapeNet => format!("{}_{}", part(object.and_then(Path::parent)), part(object)),
            _ => file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
        }
    }

    /// The mesh in metres, centred; `diameter` is for meshes whose own size cannot be that of a thing on a desk.
    pub fn load(&self, file: &Path, config: &SynthConfig, diameter: f32) -> Result<TriangleMesh, SynthError> {
        let mut mesh = mesh::load(file, config.mesh_scale)?;
        if mesh.faces.len() > MOST_FACES {
            return Err(SynthError::LargeMesh {
                path: file.to_owned(),
                faces: mesh.faces.len(),
                most: MOST_FACES,
            });
        }
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("stl")) {
            mesh = split_by_crease(&mesh, CREASE_DEG, |_| 0).0;
        }
        mesh.center_on_bounds();
        match config.mesh_size {
            MeshSize::MegaPose if self.layout == MeshLayout::ShapeNet => mesh.scale(MEGAPOSE_SCALE),
            MeshSize::MegaPose => {
                let reach = |v: &[f32; 3]| Vector3::from(*v).norm();
                let radius = mesh.vertices.iter().map(reach).fold(0.0, f32::max);
                mesh.scale(MEGAPOSE_SCALE / radius.max(1e-9));
            }
            MeshSize::Own => {
                let own = mesh.diameter();
                if !PLAUSIBLE.contains(&own) {
                    tracing::warn!(
                        "{}: {own} m in diameter, expected {} to {}; brought to {diameter:.3} m (--mesh-scale 0.001 is for \
                         millimetres)",
                        file.display(),
                        PLAUSIBLE.start(),
                        PLAUSIBLE.end()
                    );
                    mesh.scale(diameter / own);
                }
            }
        }
        if mesh.texture.is_none() && mesh.colors.is_empty() {
            mesh.colors = vec![[176; 3]; mesh.vertices.len()];
        }
        shrink_texture(&mut mesh, 2 * config.texture_size);
        Ok(mesh)
    }
}

/// Scans come with pictures of 4096 x 4096 and more: 50 MB each, of which a view shows a thousandth.
fn shrink_texture(mesh: &mut TriangleMesh, longest: u32) {
    let Some(picture) = &mesh.texture else { return };
    let side = picture.width().max(picture.height());
    if side > longest {
        let fit = |n: u32| (n * longest / side).max(1);
        let (w, h) = (fit(picture.width()), fit(picture.height()));
        mesh.texture = Some(Arc::new(image::imageops::resize(&**picture, w, h, FilterType::Triangle)));
    }
}

/// Whether a file is the one mesh of an object in this layout.
fn belongs(file: &Path, layout: MeshLayout) -> bool {
    let stem = file.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
    let folder = file.parent().and_then(Path::file_name).and_then(|s| s.to_str()).unwrap_or_default();
    match layout {
        MeshLayout::Gso => folder == "meshes" && stem == "model",
        MeshLayout::ShapeNet => folder == "models" && stem == "model_normalized",
        MeshLayout::Plain | MeshLayout::Detect => true,
    }
}

/// Mesh files below `folder`; `above` are the folders that it lies in, which links may lead back to.
fn collect(folder: &Path, above: &mut Vec<PathBuf>, found: &mut Vec<PathBuf>) -> Result<(), SynthError> {
    let error = |source| SynthError::Io { path: folder.to_owned(), source };
    let place = folder.canonicalize().map_err(error)?;
    if above.contains(&place) {
        return Ok(());
    }
    above.push(place);
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        if path.is_dir() {
            collect(&path, above, found)?;
        } else if ["ply", "obj", "stl", "glb", "gltf"].contains(&extension.as_str()) {
            found.push(path);
        }
    }
    above.pop();
    Ok(())
}

#[cfg(test)]
mod tests {
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
}
