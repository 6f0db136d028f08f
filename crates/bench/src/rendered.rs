//! Rendered references: the reference images drawn anew from the textured models, in the annotated poses.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Arc,
};

use rayon::prelude::*;
use unopose_dataset::{
    formats::{
        BopDataset, BopSplit, ReferenceTarget,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
    },
    mesh::{self, TriangleMesh},
    render::posed_view,
};

use super::BenchError;

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 0.1;

/// Draws the reference images of a list into the BOP split `folder`, numbered like the real ones; all annotated objects
/// of an image hide each other as they do there. Depth is exact.
pub(crate) fn render_references(
    dataset: &BopDataset,
    real: &BopSplit,
    targets: &[ReferenceTarget],
    folder: &Path,
) -> Result<BopSplit, BenchError> {
    let mut scenes: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for target in targets {
        scenes.entry(target.ref_scene_id).or_default().insert(target.ref_im_id);
    }
    let mut obj_ids = BTreeSet::new();
    for (&scene_id, images) in &scenes {
        let scene = real.scene(scene_id)?;
        for &im_id in images {
            obj_ids.extend(scene.gt(im_id)?.iter().map(|gt| gt.obj_id));
        }
    }
    let load = |&obj_id: &u32| -> Result<(u32, Arc<TriangleMesh>), BenchError> {
        Ok((obj_id, Arc::new(mesh::load(&dataset.textured_model_path(obj_id)?, 1e-3)?)))
    };
    let meshes: BTreeMap<u32, Arc<TriangleMesh>> = obj_ids.par_iter().map(load).collect::<Result<_, _>>()?;
    for (&scene_id, images) in &scenes {
        let images: Vec<u32> = images.iter().copied().collect();
        let drawn: Vec<SceneImage> =
            images.par_iter().map(|&im_id| draw(real, scene_id, im_id, &meshes)).collect::<Result<_, _>>()?;
        let mut writer = BopSceneWriter::new(folder, scene_id, DEPTH_SCALE, false);
        for image in &drawn {
            writer.add(image)?;
        }
        writer.finish()?;
    }
    Ok(BopSplit::open(folder)?)
}

fn draw(
    real: &BopSplit,
    scene_id: u32,
    im_id: u32,
    meshes: &BTreeMap<u32, Arc<TriangleMesh>>,
) -> Result<SceneImage, BenchError> {
    let annotated = real.scene(scene_id)?;
    let (width, height) = annotated.image_size(im_id)?;
    let (mut obj_ids, mut objects) = (Vec::new(), Vec::new());
    for (instance, gt) in annotated.gt(im_id)?.iter().enumerate() {
        if let Some(mesh) = meshes.get(&gt.obj_id) {
            obj_ids.push(gt.obj_id);
            objects.push((mesh.clone(), annotated.pose(im_id, instance)?));
        }
    }
    let view = posed_view(&objects, annotated.camera(im_id)?.intrinsics, [width, height]);
    let instances = obj_ids.into_iter().zip(&objects).zip(view.instances).map(
        |((obj_id, &(_, t_camera_object)), view)| SceneInstance {
            obj_id,
            t_camera_object,
            mask: view.mask,
            mask_visib: view.mask_visib,
            px_count_all: view.px_count_all,
        },
    );
    Ok(SceneImage { im_id, instances: instances.collect(), frame: view.frame })
}
