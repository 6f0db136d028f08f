//! A small BOP test set: scenes, models, targets, references and exact detections.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;
use unopose_core::{config::SynthConfig, files::write_atomic, folder_lock::FolderLock, frame::RgbdFrame};
use unopose_dataset::{
    formats::{
        ModelInfo,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
        models::{read_models_info, write_models_info},
    },
    mesh::{TriangleMesh, ply},
};

use super::{
    SynthError, bop_lists,
    folder::{Layout, check, remove_parts, reserve},
    models::write_models,
    object::SynthObject,
    object_cache::ObjectCache,
    progress::{GenerationProgress, GenerationSummary, Reporter, Stage},
    shard::{self, Image},
};

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 0.1;

/// Makes `config.images` test images in BOP's layout below `out`. Finished scenes of an earlier run are kept. Refuses a
/// folder that another process fills.
pub fn generate_bop(
    config: &SynthConfig,
    out: &Path,
    progress: &(dyn Fn(GenerationProgress) + Sync),
) -> Result<GenerationSummary, SynthError> {
    check(config)?;
    let _lock = FolderLock::exclusive(out)?;
    reserve(config, out, Layout::Scenes)?;
    remove_parts(out)?;
    let reporter = Reporter::new(progress);
    let mut cache = ObjectCache::new(config)?;
    write_models(config, out, "synth", &mut cache, &reporter)?;
    let assets = cache.scene_assets(config, 0)?;
    let infos = write_eval_models(out, &assets.objects)?;
    let split = out.join("test");
    let scenes = shard::scene_count(config, config.images);
    let (done, total) = (AtomicUsize::new(0), config.images);
    let made: Vec<Result<usize, SynthError>> = (0..scenes)
        .into_par_iter()
        .map(|k| {
            reporter.go_on()?;
            // BOP counts scenes from 1.
            let scene_id = k as u32 + 1;
            let mut images = 0;
            if !split.join(format!("{scene_id:06}/scene_camera.json")).is_file() {
                let made = shard::images_of_scene(config, &assets, 0, k, config.images);
                images = made.len();
                write_scene(&split, scene_id, made)?;
            }
            let done = done.fetch_add(config.views_per_scene, Ordering::Relaxed) + config.views_per_scene;
            reporter.report(Stage::Images, done.min(total), total);
            Ok(images)
        })
        .collect();
    let mut summary = GenerationSummary { meshes_replaced: cache.replaced(), ..GenerationSummary::default() };
    for images in made {
        let images = images?;
        summary.images_written += images;
        *(if images > 0 { &mut summary.shards_written } else { &mut summary.shards_kept }) += 1;
    }
    bop_lists::write_lists(config, out, &assets.objects, &infos)?;
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
