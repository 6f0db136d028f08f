//! The models of a set, loaded when first needed.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use unopose_dataset::{
    formats::{FormatError, ModelInfo, models::read_models_info, units},
    mesh::{self, TriangleMesh},
};

use super::report::Finding;

/// Models kept in memory at a time.
const KEPT: usize = 256;

/// The model folder of a set.
#[derive(Debug, Default)]
pub(super) struct Models {
    /// Folder with `obj_OOOOOO.ply`, if any is there.
    folder: Option<PathBuf>,
    pub infos: BTreeMap<u32, ModelInfo>,
    meshes: Mutex<HashMap<u32, Option<Arc<TriangleMesh>>>>,
    findings: Mutex<BTreeMap<u32, Finding>>,
}

impl Models {
    /// `models_eval` or `models` in the first of `roots` that has one.
    pub fn find(roots: &[&Path]) -> Result<Self, FormatError> {
        let folders = roots.iter().flat_map(|root| ["models_eval", "models"].map(|name| root.join(name)));
        let Some(folder) = folders.into_iter().find(|f| f.join("models_info.json").is_file()) else {
            return Ok(Self::default());
        };
        let infos = read_models_info(&folder.join("models_info.json"))?;
        let has_meshes = infos.keys().any(|&id| mesh_path(&folder, id).is_file());
        Ok(Self { folder: has_meshes.then_some(folder), infos, ..Self::default() })
    }

    /// The mesh of an object; `None` when the set has none or it cannot be read.
    pub fn mesh(&self, obj_id: u32) -> Option<Arc<TriangleMesh>> {
        let folder = self.folder.as_ref()?;
        if let Some(known) = self.meshes.lock().unwrap_or_else(PoisonError::into_inner).get(&obj_id) {
            return known.clone();
        }
        let path = mesh_path(folder, obj_id);
        let loaded = match mesh::load(&path, 0.001) {
            Ok(mesh) => {
                self.compare(obj_id, &path, &mesh);
                Some(Arc::new(mesh))
            }
            Err(error) => {
                self.note(obj_id, Finding::new("models", error));
                None
            }
        };
        let mut meshes = self.meshes.lock().unwrap_or_else(PoisonError::into_inner);
        if meshes.len() >= KEPT {
            meshes.clear();
        }
        meshes.insert(obj_id, loaded.clone());
        loaded
    }

    fn compare(&self, obj_id: u32, path: &Path, mesh: &TriangleMesh) {
        let own = f64::from(mesh.diameter());
        let finding = |what: String| self.note(obj_id, Finding::new(path.display(), what));
        if let Some(problem) = units::diameter_problem(own) {
            finding(problem);
        } else if let Some(info) = self.infos.get(&obj_id) {
            if (own - info.diameter).abs() > 0.02 * own {
                let (own, said) = (own * 1000.0, info.diameter * 1000.0);
                finding(format!("diameter is {own:.2} mm, models_info.json says {said:.2} mm"));
            }
        } else {
            finding(format!("object {obj_id} is not in models_info.json"));
        }
    }

    fn note(&self, obj_id: u32, finding: Finding) {
        self.findings.lock().unwrap_or_else(PoisonError::into_inner).insert(obj_id, finding);
    }

    /// What was wrong with the models that were needed.
    pub fn into_findings(self) -> impl Iterator<Item = Finding> {
        self.findings.into_inner().unwrap_or_else(PoisonError::into_inner).into_values()
    }
}

fn mesh_path(folder: &Path, obj_id: u32) -> PathBuf {
    folder.join(format!("obj_{obj_id:06}.ply"))
}
