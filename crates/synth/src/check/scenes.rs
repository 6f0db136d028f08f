//! BOP sets: scenes, their images and files.

use rayon::prelude::*;
use unopose_core::frame::Mask;
use unopose_dataset::formats::{BopDataset, BopScene, BopSplit, FormatError, image_io::read_mask};

use super::{
    image::ImageUnderCheck,
    lists::check_targets,
    models::Models,
    report::{CheckReport, Finding, PartReport},
    statistics::Statistics,
};
use crate::SynthError;

/// Checks every scene of the splits, decoding each `step`-th image.
pub(super) fn check(
    dataset: &BopDataset,
    splits: &[String],
    step: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<CheckReport, SynthError> {
    let models = Models::find(&[dataset.root()])?;
    let splits = splits.iter().map(|name| dataset.split(name)).collect::<Result<Vec<BopSplit>, _>>()?;
    let total = splits.iter().map(|s| s.scene_ids().len()).sum();
    let mut report = CheckReport { set: PartReport::new("set"), ..CheckReport::default() };
    for split in &splits {
        for &scene_id in split.scene_ids() {
            let folder = split.scene_folder(scene_id).unwrap_or(split.folder());
            let name = folder.display().to_string();
            let part = match split.scene(scene_id) {
                Ok(scene) => check_scene(&name, &scene, step, &models),
                Err(error) => {
                    let mut part = PartReport::new(&name);
                    part.add([Finding::new("scene", error)]);
                    part
                }
            };
            report.parts.push(part);
            progress(report.parts.len(), total);
        }
    }
    report.set.add(check_targets(dataset.root(), &splits));
    report.set.add(models.into_findings());
    Ok(report)
}

fn check_scene(name: &str, scene: &BopScene, step: usize, models: &Models) -> PartReport {
    let mut part = PartReport::new(name);
    let images: Vec<u32> = scene.image_ids().collect();
    part.images = images.len();
    part.add(unlisted_files(scene, &images));
    part.add(unlisted_visibility(scene));
    let checked: Vec<(Result<usize, FormatError>, Vec<Finding>, Statistics)> = images
        .par_iter()
        .step_by(step)
        .map(|&im_id| {
            let mut statistics = Statistics::default();
            match check_image(name, scene, im_id, models, &mut statistics) {
                Ok((count, findings)) => (Ok(count), findings, statistics),
                Err(error) => (Err(error), Vec::new(), statistics),
            }
        })
        .collect();
    for (instances, findings, statistics) in checked {
        part.add(findings);
        match instances {
            Ok(count) => {
                part.decoded += 1;
                part.instances += count;
            }
            // The message names the file.
            Err(error) => part.add([Finding::new("image", error)]),
        }
        part.statistics.merge(&statistics);
    }
    part
}

fn check_image(
    name: &str,
    scene: &BopScene,
    im_id: u32,
    models: &Models,
    statistics: &mut Statistics,
) -> Result<(usize, Vec<Finding>), FormatError> {
    let frame = scene.frame(im_id)?;
    let (gt, info) = (scene.gt(im_id)?, scene.gt_info(im_id)?);
    let same_size = |mask: Mask, place: String| -> Result<Mask, FormatError> {
        if (mask.width, mask.height) == (frame.width(), frame.height()) {
            return Ok(mask);
        }
        let size = format!("{} x {}", mask.width, mask.height);
        Err(FormatError::field(place, "mask size", size, "that of the image"))
    };
    let whole = |i: usize| scene.mask_path("mask", im_id, i);
    let visible = (0..gt.len())
        .map(|i| same_size(scene.mask_visib(im_id, i)?, format!("{name}: image {im_id} instance {i}")))
        .collect::<Result<Vec<_>, _>>()?;
    // Sets without whole silhouettes are in use, too.
    let masks = match scene.folder.join("mask").is_dir() {
        true => (0..gt.len())
            .map(|i| same_size(read_mask(&whole(i))?, whole(i).display().to_string()))
            .collect::<Result<Vec<_>, _>>()?,
        false => Vec::new(),
    };
    let place = format!("{name}: image {im_id}");
    let image = ImageUnderCheck { place, frame: &frame, gt, info, masks, visible, skipped: Vec::new() };
    Ok((gt.len(), image.check(models, statistics)))
}

/// Pictures that `scene_camera.json` does not know.
fn unlisted_files(scene: &BopScene, images: &[u32]) -> Option<Finding> {
    let entries = std::fs::read_dir(scene.folder.join("rgb")).ok()?.filter_map(Result::ok);
    let number = |e: std::fs::DirEntry| e.path().file_stem()?.to_str()?.parse::<u32>().ok();
    let unlisted = entries.filter_map(number).filter(|id| images.binary_search(id).is_err()).count();
    (unlisted > 0).then(|| {
        let what = format!("{unlisted} pictures are not in scene_camera.json");
        Finding::new(scene.folder.join("rgb").display(), what)
    })
}

/// Annotated images that `scene_gt_info.json` does not know; readers take their visibility from the masks.
fn unlisted_visibility(scene: &BopScene) -> Option<Finding> {
    let count = scene.images_without_info();
    (count > 0).then(|| {
        let what =
            format!("{count} annotated images have no entry, expected one for each image of scene_gt.json");
        Finding::new(scene.folder.join("scene_gt_info.json").display(), what)
    })
}
