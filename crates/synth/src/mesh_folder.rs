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
#[path = "mesh_folder_tests.rs"]
mod tests;
