//! Overlays of the best and the worst poses of a method.

use std::{collections::BTreeMap, path::Path};

use image::{Rgb, RgbImage};
use nalgebra::Point3;
use unopose_core::geometry::Pose;
use unopose_dataset::{
    formats::{FormatError, ReferenceTarget},
    protocol::TargetList,
};
use unopose_eval::{
    metrics::{Evaluation, TargetOutcome},
    report::overlay::{contact_sheet, cutout, pose_overlay, write_png},
};

use super::{BenchError, run::MethodRun};

/// Cases of a sheet, and of one of its rows.
const CASES: usize = 6;
const COLUMNS: usize = 6;
/// Side of a case, pixels.
const TILE: u32 = 200;
const COLOR: Rgb<u8> = Rgb([255, 170, 0]);

/// A picture of several cases.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    /// Name inside the folder of the report.
    pub file: String,
    pub caption: String,
}

/// The two pictures of a method.
#[derive(Clone, Debug)]
pub(crate) struct Examples {
    pub method: String,
    pub worst: Sheet,
    pub best: Sheet,
}

impl Examples {
    /// Draws the cases of a run into `folder`, ordered by their part in the average recall, then by MSSD.
    pub(crate) fn draw(
        list: &TargetList,
        run: &MethodRun,
        evaluation: &Evaluation,
        folder: &Path,
    ) -> Result<Self, BenchError> {
        let posed: BTreeMap<(u32, u32, u32), &(ReferenceTarget, Pose)> = run
            .relative
            .iter()
            .map(|entry| ((entry.0.scene_id, entry.0.im_id, entry.0.obj_id), entry))
            .collect();
        let key = |t: &TargetOutcome| (t.scene_id, t.im_id, t.obj_id);
        let mssd = |t: &TargetOutcome| t.errors.as_ref().map_or(f64::INFINITY, |e| e.mssd);
        let mut cases: Vec<&TargetOutcome> =
            evaluation.targets.iter().filter(|t| posed.contains_key(&key(t))).collect();
        cases.sort_by(|a, b| {
            a.average_recall().total_cmp(&b.average_recall()).then(mssd(b).total_cmp(&mssd(a)))
        });
        let count = CASES.min(cases.len());
        let best: Vec<&TargetOutcome> = cases.iter().rev().take(count).copied().collect();
        let sheet = |kind: &str, cases: &[&TargetOutcome]| -> Result<Sheet, BenchError> {
            let file = format!("{}-{kind}.png", run.name);
            let entries = cases.iter().filter_map(|t| posed.get(&key(t)));
            // Kept poses may be of images that are gone.
            let drawn = entries.filter_map(|(target, pose)| {
                let drawn = tile(list, target, pose);
                drawn.inspect_err(|error| tracing::warn!("{file}: a case is not drawn: {error}")).ok()
            });
            let tiles: Vec<RgbImage> = drawn.collect();
            write_png(&folder.join(&file), &contact_sheet(&tiles, COLUMNS))?;
            let caption = cases.iter().map(|t| {
                format!(
                    "scene {} image {} object {} ({:.2})",
                    t.scene_id,
                    t.im_id,
                    t.obj_id,
                    t.average_recall()
                )
            });
            Ok(Sheet { file, caption: caption.collect::<Vec<_>>().join(", ") })
        };
        Ok(Self {
            method: run.name.clone(),
            worst: sheet("worst", &cases[..count])?,
            best: sheet("best", &best)?,
        })
    }
}

/// The part of the query image around the true object, with the reference's points in the estimated pose.
fn tile(
    list: &TargetList,
    target: &ReferenceTarget,
    t_query_reference: &Pose,
) -> Result<RgbImage, FormatError> {
    let (split, obj_id) = (list.reference_split(), target.obj_id);
    let scene = split.scene(target.ref_scene_id)?;
    let reference = scene.frame(target.ref_im_id)?;
    let (index, _) = scene.most_visible(target.ref_im_id, obj_id)?;
    let points = reference.masked_points(&scene.mask_visib(target.ref_im_id, index)?);
    let query_scene = list.split.scene(target.scene_id)?;
    let query = query_scene.frame(target.im_id)?;
    let camera = &query.intrinsics;
    let drawn = pose_overlay(&query.rgb, camera, t_query_reference, &points, COLOR);
    let (_, truth) = query_scene.most_visible(target.im_id, obj_id)?;
    let center = camera.project(&Point3::from(truth.translation));
    let diameter = list.dataset.models_info()?.get(&obj_id).map_or(0.2, |info| info.diameter);
    let half = (0.8 * diameter * camera.fx / truth.translation.z.max(0.05)).max(20.0);
    Ok(cutout(&drawn, center.map_or((0.0, 0.0), |c| (c.x, c.y)), half, TILE))
}
