//! What the metrics need to know of an object.

use std::collections::BTreeMap;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use unopose_core::geometry::Pose;
use unopose_dataset::{
    formats::{BopDataset, ObjectSymmetries},
    mesh::{self, TriangleMesh},
};

use super::EvalError;

const METRES_PER_MM: f32 = 1e-3;

/// Evaluation model of an object, metres.
#[derive(Clone, Debug)]
pub struct EvalObject {
    /// Evaluation model of the dataset, with which the errors are computed.
    pub mesh: TriangleMesh,
    /// Largest distance between two vertices as `models_info.json` gives it, metres.
    pub diameter: f64,
    /// All symmetries, the identity among them.
    pub symmetries: Vec<Pose>,
    /// Of the vertices; `None` without any.
    tree: Option<ImmutableKdTree<f32, 3>>,
}

impl EvalObject {
    /// With the symmetries expanded as BOP does.
    pub fn new(mesh: TriangleMesh, diameter: f64, symmetries: &ObjectSymmetries) -> Self {
        let tree = (!mesh.vertices.is_empty()).then(|| ImmutableKdTree::new_from_slice(&mesh.vertices));
        Self { mesh, diameter, symmetries: symmetries.expand(ObjectSymmetries::BOP_STEP), tree }
    }

    /// Is there a symmetry besides the identity?
    pub(super) fn is_symmetric(&self) -> bool {
        self.symmetries.len() > 1
    }

    /// Distance from a point (object frame, metres) to the nearest vertex; infinite without vertices.
    pub(super) fn distance_to_vertices(&self, point: &[f32; 3]) -> f64 {
        let nearest = self.tree.as_ref().map(|tree| tree.nearest_one::<SquaredEuclidean>(point).distance);
        nearest.map_or(f64::INFINITY, |squared| f64::from(squared).sqrt())
    }

    /// Loads the evaluation models of the given objects.
    pub fn load_all(
        dataset: &BopDataset,
        obj_ids: impl IntoIterator<Item = u32>,
    ) -> Result<BTreeMap<u32, Self>, EvalError> {
        let infos = dataset.models_info()?;
        let load = |obj_id: u32| {
            let path = dataset.eval_model_path(obj_id)?;
            let info = infos
                .get(&obj_id)
                .ok_or_else(|| EvalError::UnknownObject { file: dataset.models_info_place(), obj_id })?;
            let mesh = mesh::load(&path, METRES_PER_MM)?;
            Ok((obj_id, Self::new(mesh, info.diameter, &info.symmetries)))
        };
        let obj_ids: Vec<u32> = obj_ids.into_iter().collect();
        obj_ids.into_par_iter().map(load).collect()
    }
}
