//! Visibility of instances where no file gives it.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use unopose_core::{
    frame::{BoundingBox, DepthMap, Mask},
    geometry::{Intrinsics, Pose},
};

use super::{BopDataset, records::GtInfoRecord};
use crate::{
    mesh::{self, TriangleMesh},
    render::{Camera, Finish, PosedMesh, instance_views},
};

/// Of no matter for outlines.
const MATT: Finish = Finish { roughness: 1.0, metallic: 0.0 };

/// Models of the dataset that a split is of, each loaded when it is first needed.
#[derive(Debug)]
pub(super) struct SilhouetteModels {
    root: PathBuf,
    meshes: Mutex<BTreeMap<u32, Option<Arc<TriangleMesh>>>>,
}

impl SilhouetteModels {
    /// Those in the folder of the split's dataset.
    pub(super) fn beside(split: &Path) -> Self {
        Self { root: split.parent().unwrap_or(split).to_path_buf(), meshes: Mutex::default() }
    }

    /// `None` where the dataset has no readable model of the object.
    pub(super) fn get(&self, obj_id: u32) -> Option<Arc<TriangleMesh>> {
        let mut meshes = self.meshes.lock().unwrap_or_else(PoisonError::into_inner);
        let load = || {
            let dataset = BopDataset::open(&self.root).ok()?;
            let path =
                dataset.eval_model_path(obj_id).or_else(|_| dataset.textured_model_path(obj_id)).ok()?;
            let loaded = mesh::load(&path, 1e-3).inspect_err(|error| tracing::warn!("{error}"));
            loaded.ok().map(Arc::new)
        };
        meshes.entry(obj_id).or_insert_with(load).clone()
    }
}

/// An object as if nothing were in front of it.
pub(super) struct Silhouette<'a> {
    /// Inside the image.
    pub mask: Cow<'a, Mask>,
    /// Pixels, outside the image as well where that is known.
    pub px_count_all: u32,
}

impl<'a> Silhouette<'a> {
    /// What is known of it inside the image. More cannot be visible than there is.
    pub(super) fn of_mask(mask: Cow<'a, Mask>, visible: &Mask) -> Self {
        let px_count_all = mask.count().max(visible.count()) as u32;
        Self { mask, px_count_all }
    }

    /// Of a posed model, whose outline may be smaller than that of the mask.
    pub(super) fn of_mesh(
        mesh: Arc<TriangleMesh>,
        t_camera_object: Pose,
        intrinsics: Intrinsics,
        visible: &Mask,
    ) -> Self {
        let placed = PosedMesh { mesh, finish: MATT, t_world_object: t_camera_object };
        let (width, height) = (visible.width, visible.height);
        let camera = Camera { t_camera_world: Pose::identity(), intrinsics, width, height };
        let (mask, count) = match instance_views(&[placed], &camera, &[]).pop() {
            Some(view) => (view.mask, view.px_count_all),
            None => (Mask::empty(width, height), 0),
        };
        Self { mask: Cow::Owned(mask), px_count_all: count.max(visible.count() as u32) }
    }
}

/// What `scene_gt_info.json` says of an instance.
pub(super) fn gt_info(silhouette: &Silhouette, visible: &Mask, depth: Option<&DepthMap>) -> GtInfoRecord {
    let px_count_visib = visible.count() as u32;
    let measured = depth.map_or(0, |depth| {
        silhouette.mask.data.iter().zip(&depth.data).filter(|&(&m, &z)| m && z > 0.0).count()
    });
    GtInfoRecord {
        bbox_obj: bop_box(silhouette.mask.bounding_box()),
        bbox_visib: bop_box(visible.bounding_box()),
        px_count_all: silhouette.px_count_all,
        px_count_valid: measured as u32,
        px_count_visib,
        visib_fract: f64::from(px_count_visib) / f64::from(silhouette.px_count_all.max(1)),
    }
}

/// x, y, width, height with BOP's width `x_max - x_min` (one less than the number of columns).
fn bop_box(bounds: Option<BoundingBox>) -> [i32; 4] {
    bounds.map_or([-1; 4], |b| {
        let size = |min: u32, max: u32| (max - min - 1) as i32;
        [b.col_min as i32, b.row_min as i32, size(b.col_min, b.col_max), size(b.row_min, b.row_max)]
    })
}
