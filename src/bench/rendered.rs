//! Rendered references: the reference images drawn anew from the textured models, in the annotated poses.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Arc,
};

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::BenchError;
use crate::{
    formats::{
        BopDataset, BopSplit, ReferenceTarget,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
    },
    frame::RgbdFrame,
    geometry::Pose,
    mesh::{self, TriangleMesh},
    render::{
        Camera, Finish, Light, Placed, Room, Scene, SceneRenderer, Surface, instance_views,
        texture::linear_to_srgb,
    },
};

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 0.1;
const MATT: Finish = Finish { roughness: 0.8, metallic: 0.0 };
/// Samples per pixel and direction.
const DENSITY: u32 = 2;
/// Part of the light that comes from everywhere, and from the lamp beside the camera.
const AMBIENT: f32 = 0.35;
const LAMP: f32 = 0.65;

/// Draws the reference images of a list into the BOP split `folder`, numbered like the real ones; all annotated objects
/// of an image hide each other as they do there. Depth is exact.
pub fn render_references(
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
    // z up, the camera at the origin, level.
    let t_camera_world =
        Pose::new(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0), Vector3::zeros());
    let t_world_camera = t_camera_world.inverse();
    let place = format!("{}: image {im_id}", annotated.folder.join("scene_gt.json").display());
    let (mut objects, mut poses) = (Vec::new(), Vec::new());
    for gt in annotated.gt(im_id)? {
        let t_camera_object = gt.pose(&place)?;
        if let Some(mesh) = meshes.get(&gt.obj_id) {
            let t_world_object = t_world_camera * t_camera_object;
            objects.push(Placed { mesh: mesh.clone(), finish: MATT, t_world_object });
            poses.push((gt.obj_id, t_camera_object));
        }
    }
    let intrinsics = annotated.camera(im_id)?.intrinsics;
    let camera = Camera { t_camera_world, intrinsics, width, height };
    let lamp = Light { position: Vector3::new(0.3, -0.2, 0.5), radius: 0.2, color: [LAMP; 3] };
    let scene =
        Scene { objects, room: empty_room(), lights: vec![lamp], sky: [AMBIENT; 3], ground: [AMBIENT; 3] };
    let rendering = SceneRenderer::new(&scene).render(&camera, DENSITY);
    let views = instance_views(&scene.objects, &camera, &rendering.ids);
    let code = |c: f32| (linear_to_srgb(c.clamp(0.0, 1.0)) * 255.0).round() as u8;
    let rgb = image::RgbImage::from_fn(width, height, |col, row| {
        image::Rgb(rendering.radiance[row as usize * width as usize + col as usize].map(code))
    });
    let mut depth = rendering.depth;
    depth.data.iter_mut().zip(&rendering.ids).filter(|(_, id)| **id == 0).for_each(|(z, _)| *z = 0.0);
    let instances = poses.into_iter().zip(views).map(|((obj_id, t_camera_object), view)| SceneInstance {
        obj_id,
        t_camera_object,
        mask: view.mask,
        mask_visib: view.mask_visib,
        px_count_all: view.px_count_all,
    });
    let instances = instances.collect();
    Ok(SceneImage { im_id, frame: RgbdFrame { rgb, depth, intrinsics }, instances })
}

/// Grey walls far from everything.
fn empty_room() -> Room {
    let picture = Arc::new(image::RgbImage::from_pixel(1, 1, image::Rgb([128; 3])));
    let surface = Surface { picture, tile: 1.0, angle: 0.0, finish: MATT };
    Room {
        blocks: Vec::new(),
        floor: surface.clone(),
        wall: surface,
        floor_drop: 20.0,
        half: 20.0,
        ceiling: 20.0,
    }
}
