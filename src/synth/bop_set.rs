//! A small BOP test set: scenes, models, targets, references and exact detections.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;

use super::{
    Progress, Stage, Summary, SynthError,
    folder::{check, claim},
    generate::pool_of,
    models::{ObjectCache, write_models},
    object::SynthObject,
    random::{Domain, Draw, stream},
    shard::{self, Image},
};
use crate::{
    config::SynthConfig,
    formats::{
        BopDataset, ModelInfo, ReferenceTarget, Target,
        bop::{BopSceneWriter, BopSplit, SceneImage, SceneInstance},
        detections::{Detection, write_detections},
        models::{read_models_info, write_models_info},
        rle::Rle,
        targets::write_targets,
        write_atomic,
    },
    frame::RgbdFrame,
    geometry::Pose,
    mesh::{TriangleMesh, ply},
};

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 0.1;
/// Targets: at least this visible share, and this many pixels in an image 640 pixels wide.
const TARGET: (f64, f64) = (0.1, 150.0);
/// The same for references.
const REFERENCE: (f64, f64) = (0.7, 900.0);
/// Largest angle between target and reference view, degrees.
const MAX_ROTATION_DEG: f64 = 50.0;

/// Makes `config.images` test images in BOP's layout below `out`. Finished scenes of an earlier run are kept.
pub fn generate_bop(
    config: &SynthConfig,
    out: &Path,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Summary, SynthError> {
    check(config)?;
    claim(config, out)?;
    let mut cache = ObjectCache::new(config)?;
    write_models(config, out, "synth", &mut cache, progress)?;
    let objects = cache.get(&pool_of(config, 0), &|| {});
    let infos = write_eval_models(out, &objects)?;
    let split = out.join("test");
    let scenes = shard::scene_count(config, config.images);
    let (done, total) = (AtomicUsize::new(0), config.images);
    let made: Vec<Result<usize, SynthError>> = (0..scenes)
        .into_par_iter()
        .map(|k| {
            // BOP counts scenes from 1.
            let scene_id = k as u32 + 1;
            let mut images = 0;
            if !split.join(format!("{scene_id:06}/scene_camera.json")).is_file() {
                let made = shard::images_of_scene(config, &objects, 0, k, config.images);
                images = made.len();
                write_scene(&split, scene_id, made)?;
            }
            let done = done.fetch_add(config.views_per_scene, Ordering::Relaxed) + config.views_per_scene;
            progress(Progress { stage: Stage::Images, done: done.min(total), total });
            Ok(images)
        })
        .collect();
    let mut summary = Summary::default();
    for images in made {
        let images = images?;
        summary.images_written += images;
        *(if images > 0 { &mut summary.shards_written } else { &mut summary.shards_kept }) += 1;
    }
    write_lists(config, out, &infos)?;
    Ok(summary)
}

/// `models_eval/`: geometry without texture. Returns the infos of all models.
fn write_eval_models(out: &Path, objects: &[SynthObject]) -> Result<BTreeMap<u32, ModelInfo>, SynthError> {
    let folder = out.join("models_eval");
    let infos = read_models_info(&out.join("models/models_info.json"))?;
    if folder.join("models_info.json").is_file() {
        return Ok(infos);
    }
    objects.par_iter().try_for_each(|object| {
        let bare =
            TriangleMesh { uvs: Vec::new(), colors: Vec::new(), texture: None, ..(*object.mesh).clone() };
        let path = folder.join(format!("obj_{:06}.ply", object.obj_id));
        write_atomic(&path, |file| ply::write(&bare, 1000.0, None, file))
    })?;
    write_models_info(&folder.join("models_info.json"), &infos)?;
    Ok(infos)
}

fn write_scene(split: &Path, scene_id: u32, images: Vec<Image>) -> Result<(), SynthError> {
    let mut writer = BopSceneWriter::new(split, scene_id, DEPTH_SCALE, false);
    for (im_id, image) in images.into_iter().enumerate() {
        let place = format!("scene {scene_id}, image {im_id}");
        let records = &image.records;
        let instance = |i: usize| -> Result<SceneInstance, SynthError> {
            Ok(SceneInstance {
                obj_id: records.gt[i].obj_id,
                t_camera_object: records.gt[i].pose(&place)?,
                mask: records.mask[i].decode()?,
                mask_visib: records.mask_visib[i].decode()?,
                px_count_all: records.gt_info[i].px_count_all,
            })
        };
        let instances = (0..records.gt.len()).map(instance).collect::<Result<_, _>>()?;
        let intrinsics = records.camera.check(&place)?.intrinsics;
        let frame = RgbdFrame { rgb: image.rgb, depth: image.depth, intrinsics };
        writer.add(&SceneImage { im_id: im_id as u32, frame, instances })?;
    }
    Ok(writer.finish()?)
}

/// An instance of the finished set.
struct Seen {
    scene_id: u32,
    im_id: u32,
    instance: usize,
    obj_id: u32,
    t_camera_object: Pose,
    visib_fract: f64,
    px_count_visib: f64,
    bbox_visib: [i32; 4],
    /// The silhouette does not touch the border.
    whole: bool,
}

/// Target list, one-reference list (other scenes only) and exact detections of all targets.
fn write_lists(config: &SynthConfig, out: &Path, infos: &BTreeMap<u32, ModelInfo>) -> Result<(), SynthError> {
    let split = BopDataset::open(out)?.split("test")?;
    let seen = seen_instances(config, &split)?;
    let scale = (f64::from(config.width) / 640.0).powi(2);
    let passes =
        |s: &Seen, limit: (f64, f64)| s.visib_fract >= limit.0 && s.px_count_visib >= limit.1 * scale;
    let mut rng = stream(config.seed, Domain::Pool, u64::MAX);
    let (mut targets, mut references, mut detections) = (BTreeMap::new(), Vec::new(), Vec::new());
    for target in seen.iter().filter(|s| passes(s, TARGET)) {
        let Some(info) = infos.get(&target.obj_id) else { continue };
        let angle =
            |r: &Seen| info.symmetries.rotation_distance_deg(&target.t_camera_object, &r.t_camera_object);
        let candidates: Vec<(&Seen, f64)> = seen
            .iter()
            .filter(|r| r.obj_id == target.obj_id && r.scene_id != target.scene_id && r.whole)
            .filter(|r| passes(r, REFERENCE))
            .map(|r| (r, angle(r)))
            .filter(|(_, degrees)| *degrees <= MAX_ROTATION_DEG)
            .collect();
        if candidates.is_empty() {
            continue;
        }
        let (reference, degrees) = *rng.pick(&candidates);
        let (scene_id, im_id, obj_id) = (target.scene_id, target.im_id, target.obj_id);
        targets.insert((scene_id, im_id, obj_id), Target { scene_id, im_id, obj_id, inst_count: 1 });
        references.push(ReferenceTarget {
            scene_id,
            im_id,
            obj_id,
            ref_scene_id: reference.scene_id,
            ref_im_id: reference.im_id,
            rot_deg: Some(degrees),
            overlap: None,
        });
        let mask = split.scene(scene_id)?.mask_visib(im_id, target.instance)?;
        detections.push(Detection {
            scene_id,
            image_id: im_id,
            category_id: obj_id,
            bbox: target.bbox_visib.map(f64::from),
            score: 1.0,
            time: 0.0,
            segmentation: Rle::encode_compressed(&mask),
        });
    }
    let targets: Vec<Target> = targets.into_values().collect();
    write_targets(&out.join("test_targets_bop19.json"), &targets)?;
    write_targets(&out.join("test_ref_targets_crossscene_rot50.json"), &references)?;
    Ok(write_detections(&out.join("dets_gt.json"), &detections)?)
}

fn seen_instances(config: &SynthConfig, split: &BopSplit) -> Result<Vec<Seen>, SynthError> {
    let (width, height) = (config.width as i32, config.height as i32);
    let mut seen = Vec::new();
    for &scene_id in split.scene_ids() {
        let scene = split.scene(scene_id)?;
        for im_id in scene.image_ids() {
            for (instance, (gt, info)) in scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate() {
                let [x, y, w, h] = info.bbox_obj;
                seen.push(Seen {
                    scene_id,
                    im_id,
                    instance,
                    obj_id: gt.obj_id,
                    t_camera_object: gt.pose(&format!("scene {scene_id}, image {im_id}"))?,
                    visib_fract: info.visib_fract,
                    px_count_visib: info.px_count_visib.into(),
                    bbox_visib: info.bbox_visib,
                    whole: x > 0 && y > 0 && x + w < width - 1 && y + h < height - 1,
                });
            }
        }
    }
    Ok(seen)
}
