//! Object meshes beside the images.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;
use unopose_core::{config::SynthConfig, files::write_atomic};
use unopose_dataset::{
    formats::{ModelInfo, files::write_json, image_io::write_rgb, models::write_models_info},
    mesh::ply,
};

use super::{
    SynthError,
    object::{LeftOpen, SynthObject},
    object_cache::ObjectCache,
    progress::{Reporter, Stage},
};

/// One entry of the models list.
#[derive(serde::Serialize)]
struct ModelName {
    obj_id: u32,
    gso_id: String,
}

/// An object whose pose only its print tells.
#[derive(serde::Serialize)]
struct PrintDecides {
    obj_id: u32,
    kind: LeftOpen,
}

/// Meshes (PLY in mm with their texture), `models_info.json` and the models list; for a set with packages also
/// `print_decides.json`, the objects whose pose only the print tells.
pub(super) fn write_models(
    config: &SynthConfig,
    out: &Path,
    set: &str,
    cache: &mut ObjectCache,
    reporter: &Reporter,
) -> Result<(), SynthError> {
    let (folder, names_file) = (out.join("models"), out.join(format!("{set}_models.json")));
    let info_file = folder.join("models_info.json");
    if names_file.is_file() && info_file.is_file() {
        return Ok(());
    }
    let (done, total) = (AtomicUsize::new(0), config.objects);
    let report = || {
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        reporter.report(Stage::Objects, done, total);
    };
    let (mut names, mut prints) = (Vec::new(), Vec::new());
    let mut infos = BTreeMap::new();
    let ids: Vec<u32> = (1..=config.objects as u32).collect();
    for chunk in ids.chunks(config.objects_per_shard) {
        reporter.go_on()?;
        let objects = cache.get(chunk, &report)?;
        let written: Vec<Result<ModelInfo, SynthError>> = objects
            .par_iter()
            .map(|object| {
                if config.write_models {
                    write_model(object, &folder)?;
                }
                Ok(object.info())
            })
            .collect();
        for (object, info) in objects.iter().zip(written) {
            infos.insert(object.obj_id, info?);
            names.push(ModelName { obj_id: object.obj_id, gso_id: object.name.clone() });
            if object.left_open != LeftOpen::None {
                prints.push(PrintDecides { obj_id: object.obj_id, kind: object.left_open });
            }
        }
    }
    if config.printed > 0.0 {
        write_json(&folder.join("print_decides.json"), &prints, true)?;
    }
    write_models_info(&info_file, &infos)?;
    Ok(write_json(&names_file, &names, true)?)
}

/// `obj_OOOOOO.ply` and `obj_OOOOOO.png`.
pub(super) fn write_model(object: &SynthObject, folder: &Path) -> Result<(), SynthError> {
    let stem = format!("obj_{:06}", object.obj_id);
    let texture = format!("{stem}.png");
    if let Some(picture) = &object.mesh.texture {
        write_rgb(&folder.join(&texture), picture)?;
    }
    let name = object.mesh.texture.is_some().then_some(texture.as_str());
    write_atomic(&folder.join(format!("{stem}.ply")), |out| ply::write(&object.mesh, 1000.0, name, out))?;
    Ok(())
}
