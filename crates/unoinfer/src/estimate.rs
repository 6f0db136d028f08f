//! `unoinfer estimate`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use image::Rgb;
use serde_json::json;
use unopose_cli::{say, tell};
use unopose_core::{explain, frame::MaskedView, geometry::Pose};
use unopose_dataset::formats::{files::write_json, image_io::MaskValue};
use unopose_doctor::{Expected, MaskedObject};
use unopose_eval::report::overlay;
use unopose_infer::{
    Estimate, InferError, PoseEstimator, ReasonKind, Reference, View, ViewFiles, ViewRole, query_folder,
};
use unopose_segment::AnyMatcher;

use super::{
    doctor::{Warning, unit_doubt, warnings},
    mask_finder::MaskFinder,
    options::{CameraOptions, EstimatorOptions, MaskOptions},
    progress::ProgressDisplay,
    proposals::ProposalOptions,
};

/// Colours of the instances' points.
const COLORS: [Rgb<u8>; 6] = [
    Rgb([255, 170, 0]),
    Rgb([0, 200, 255]),
    Rgb([255, 80, 200]),
    Rgb([140, 255, 60]),
    Rgb([160, 120, 255]),
    Rgb([255, 255, 120]),
];

#[derive(Args)]
pub struct EstimateArguments {
    /// Colour image of the query: png, jpeg, webp, tiff or bmp
    #[arg(long, value_name = "FILE", required_unless_present = "query_dir")]
    query_rgb: Option<PathBuf>,
    /// Depth image of the query, registered to the colour image: 16-bit png, tiff or pgm, npy; or floats in metres: tiff,
    /// OpenEXR, npy, pfm
    #[arg(long, value_name = "FILE", required_unless_present = "query_dir")]
    query_depth: Option<PathBuf>,
    /// Mask of an instance in the query; several times for several instances [default: found by segmentation, exit code
    /// 3 when the object is not there]
    #[arg(long, value_name = "FILE", conflicts_with = "ProposalOptions")]
    query_mask: Vec<PathBuf>,
    /// DINOv2 weights by which the object is found without --query-mask: ViT-S, B or L with or without registers,
    /// safetensors or PyTorch [default: the pose network's checkpoint finds it]
    #[arg(long, value_name = "FILE", conflicts_with = "query_mask")]
    descriptor: Option<PathBuf>,
    #[command(flatten)]
    proposals: ProposalOptions,
    /// Folder of queries instead: rgb/NAME.png|jpg|webp, depth/NAME.png|tif|npy|exr|pgm|pfm, mask/NAME.png or
    /// mask/NAME_*.png, and camera.json when it is not --camera; without mask/ the object is found in every view; results
    /// go to OUT/NAME/
    #[arg(long, value_name = "DIR", conflicts_with_all = ["query_rgb", "query_depth", "query_mask"])]
    query_dir: Option<PathBuf>,
    /// Colour image of the reference
    #[arg(long, value_name = "FILE", required_unless_present = "reference")]
    reference_rgb: Option<PathBuf>,
    /// Depth image of the reference
    #[arg(long, value_name = "FILE", required_unless_present = "reference")]
    reference_depth: Option<PathBuf>,
    /// Mask of the object in the reference
    #[arg(long, value_name = "FILE", required_unless_present = "reference")]
    reference_mask: Option<PathBuf>,
    #[command(flatten)]
    masks: MaskOptions,
    /// --mask-value of --reference-mask [default: --mask-value]
    #[arg(long, value_name = "N", requires = "reference_mask")]
    reference_mask_value: Option<MaskValue>,
    /// A reference kept by --save-reference, instead of its images
    #[arg(long, value_name = "FILE", conflicts_with_all = ["reference_rgb", "reference_depth", "reference_mask", "reference_camera"])]
    reference: Option<PathBuf>,
    /// Keep the prepared and encoded reference for later queries
    #[arg(long, value_name = "FILE", conflicts_with = "reference")]
    save_reference: Option<PathBuf>,
    /// Camera: JSON with cam_K (9 numbers) or fx, fy, cx, cy, and depth_scale (millimetres per depth unit); camera_info of ROS
    /// (YAML); intrinsics of RealSense, Open3D or OpenCV; a text of 3 x 3 numbers. Lens distortion (plumb_bob,
    /// rational_polynomial) is undone
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Camera of the reference [default: --camera]
    #[arg(long, value_name = "FILE")]
    reference_camera: Option<PathBuf>,
    #[command(flatten)]
    cameras: CameraOptions,
    /// Folder for pose.json and overlay.png: the reference's points and axes in the query image, and beside them its own colours
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    estimator: EstimatorOptions,
}

/// What the reference's view tells before anything is estimated.
struct ReferenceView {
    object: Option<MaskedObject>,
    warnings: Vec<Warning>,
}

pub fn run(arguments: &EstimateArguments) -> anyhow::Result<()> {
    let queries = queries(arguments)?;
    let estimator = arguments.estimator.estimator()?;
    let (reference, view, seen) = reference(arguments, &estimator)?;
    let generator = arguments.proposals.generator(arguments.estimator.device())?;
    let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
    let finder = match (queries.iter().any(|(_, files)| files.masks.is_empty()), &view) {
        (false, _) => None,
        (true, Some(View { frame, masks, .. })) => {
            let masked = MaskedView { frame, mask: masks.first().context("--reference-mask is missing")? };
            Some(MaskFinder::new(generator.as_ref(), &matcher, masked)?)
        }
        (true, None) => bail!("--query-mask is missing: a kept reference has no image to find the object by"),
    };

    let progress = ProgressDisplay::new("estimating");
    let mut failed = Vec::new();
    for (done, (name, files)) in queries.iter().enumerate() {
        progress.set(done, queries.len());
        let out = name.as_ref().map_or_else(|| arguments.out.clone(), |name| arguments.out.join(name));
        let query = (files, arguments.masks.mask_value);
        if let Err(error) = estimate_query(&estimator, &reference, &seen, finder.as_ref(), query, &out) {
            // One bad query of a folder does not stop the others.
            if queries.len() == 1 {
                return Err(error);
            }
            tell!("{}: {}", files.rgb.display(), explain(error.as_ref()));
            failed.push(files.rgb.display().to_string());
        }
    }
    progress.finish();
    if !failed.is_empty() {
        bail!("{} of {} queries have no pose: {}", failed.len(), queries.len(), failed.join(", "));
    }
    Ok(())
}

/// The kept reference, or the one in the images with its view (one mask).
fn reference(
    arguments: &EstimateArguments,
    estimator: &PoseEstimator,
) -> anyhow::Result<(Reference, Option<View>, ReferenceView)> {
    if let Some(kept) = &arguments.reference {
        let reference = estimator.load_reference(kept)?;
        let object = MaskedObject::measure(reference.points());
        return Ok((reference, None, ReferenceView { object, warnings: Vec::new() }));
    }
    let files = ViewFiles {
        rgb: arguments.reference_rgb.clone().context("--reference-rgb is missing")?,
        depth: arguments.reference_depth.clone().context("--reference-depth is missing")?,
        masks: arguments.reference_mask.iter().cloned().collect(),
        camera: arguments.reference_camera.clone().unwrap_or_else(|| arguments.camera.clone()),
        depth_scale: arguments.cameras.depth_scale,
    };
    let value = arguments.reference_mask_value.or(arguments.masks.mask_value);
    let view = files.read_as(ViewRole::Reference, value)?;
    let mask = view.masks.first().context("--reference-mask is missing")?;
    let expected = Expected { depth_scale: view.depth_scale, points: estimator.config().reference_points };
    let masked = MaskedView { frame: &view.frame, mask };
    let (object, warnings) =
        warnings("reference", masked, &expected, None).with_context(|| place(&files, 0))?;
    let reference = estimator.reference(&view.frame, mask).with_context(|| place(&files, 0))?;
    if let Some(path) = &arguments.save_reference {
        estimator.save_reference(&reference, path)?;
    }
    Ok((reference, Some(view), ReferenceView { object, warnings }))
}

/// Names (of a folder's views) and files.
fn queries(arguments: &EstimateArguments) -> anyhow::Result<Vec<(Option<String>, ViewFiles)>> {
    if let Some(folder) = &arguments.query_dir {
        let views = query_folder(folder, &arguments.camera, arguments.cameras.depth_scale)?;
        return Ok(views.into_iter().map(|(name, files)| (Some(name), files)).collect());
    }
    let files = ViewFiles {
        rgb: arguments.query_rgb.clone().context("--query-rgb is missing")?,
        depth: arguments.query_depth.clone().context("--query-depth is missing")?,
        masks: arguments.query_mask.clone(),
        camera: arguments.camera.clone(),
        depth_scale: arguments.cameras.depth_scale,
    };
    Ok(vec![(None, files)])
}

/// Reads a query and estimates its instances, those that `finder` finds where no masks are given.
fn estimate_query(
    estimator: &PoseEstimator,
    reference: &Reference,
    seen: &ReferenceView,
    finder: Option<&MaskFinder<'_>>,
    (files, mask_value): (&ViewFiles, Option<MaskValue>),
    out: &Path,
) -> anyhow::Result<()> {
    let view = files.read_as(ViewRole::Query, mask_value)?;
    match finder {
        Some(finder) if view.masks.is_empty() => {
            let (view, files, scores) = finder.complete(view, files, out)?;
            estimate_view(estimator, reference, seen, &view, &files, &scores, out)
        }
        _ => estimate_view(estimator, reference, seen, &view, files, &[], out),
    }
}

fn estimate_view(
    estimator: &PoseEstimator,
    reference: &Reference,
    seen: &ReferenceView,
    view: &View,
    files: &ViewFiles,
    mask_scores: &[f64],
    out: &Path,
) -> anyhow::Result<()> {
    let mut found = seen.warnings.clone();
    let expected = Expected { depth_scale: view.depth_scale, points: estimator.config().fine_points };
    for (i, mask) in view.masks.iter().enumerate() {
        let masked = MaskedView { frame: &view.frame, mask };
        found.extend(warnings(&place(files, i), masked, &expected, seen.object.as_ref())?.1);
    }
    let mut results = estimator.estimate(reference, &view.frame, &view.masks);
    // A pose in the wrong unit can look as good as a right one.
    if let Some(text) = found.iter().find_map(unit_doubt) {
        for confidence in results.iter_mut().flatten().filter_map(|estimate| estimate.confidence.as_mut()) {
            confidence.doubt(ReasonKind::DoubtfulUnit, text.clone());
        }
    }
    let estimates = results.iter().enumerate().filter_map(|(i, result)| Some((i, result.as_ref().ok()?)));
    let best = estimates.max_by(|a, b| {
        let trust = |(i, estimate): &(usize, &Estimate)| trust(estimate, mask_scores.get(*i).copied());
        trust(a).total_cmp(&trust(b)).then(a.1.score.total_cmp(&b.1.score))
    });
    let Some((_, best)) = best else {
        let reasons: Vec<String> = results
            .into_iter()
            .enumerate()
            .filter_map(|(i, result)| Some(format!("{}: {}", place(files, i), result.err()?)))
            .collect();
        bail!("{}", reasons.join("; "));
    };
    let mut value = record(estimator, reference, files, &results, mask_scores, best);
    value["warnings"] = json!(found);
    write_json(&out.join("pose.json"), &value, true)?;
    overlay::write_png(&out.join("overlay.png"), &drawn(reference, view, &results))?;
    for (i, result) in results.iter().enumerate() {
        match result {
            Ok(estimate) => say!("{}", line(files, i, estimate)),
            Err(error) => tell!("{}: {error}", place(files, i)),
        }
    }
    say!("{} and overlay.png", out.join("pose.json").display());
    Ok(())
}

/// By how much an instance is the one to take: the probability that its pose is right, and that its mask is the object where
/// the program found it. Without a calibration the network's score.
fn trust(estimate: &Estimate, mask_score: Option<f64>) -> f64 {
    let pose = estimate.confidence.as_ref().map_or(estimate.score, |confidence| confidence.probability);
    pose * mask_score.unwrap_or(1.0)
}

/// The best instance's pose, then all instances.
fn record(
    estimator: &PoseEstimator,
    reference: &Reference,
    files: &ViewFiles,
    results: &[Result<Estimate, InferError>],
    mask_scores: &[f64],
    best: &Estimate,
) -> serde_json::Value {
    let instances: Vec<serde_json::Value> = results
        .iter()
        .zip(&files.masks)
        .enumerate()
        .map(|(index, (result, mask))| {
            let mut value = match result {
                Ok(estimate) => fields(estimate),
                Err(error) => json!({ "error": error.to_string() }),
            };
            value["mask"] = json!(mask.display().to_string());
            if let Some(score) = mask_scores.get(index) {
                value["mask_score"] = json!(score);
            }
            value
        })
        .collect();
    let mut value = fields(best);
    value["instances"] = json!(instances);
    value["reference"] = json!({
        "radius_m": reference.radius(),
        "points": reference.points().len(),
        "seconds": reference.seconds(),
    });
    value["checkpoint"] = json!(estimator.source());
    value["device"] = json!(estimator.backend().to_string());
    value
}

fn fields(estimate: &Estimate) -> serde_json::Value {
    let pose = |pose: &Pose| json!({ "R": pose.rotation_row_major(), "t": pose.translation.as_slice() });
    let alternatives: Vec<serde_json::Value> = estimate
        .alternatives
        .iter()
        .map(|other| json!({ "T_query_reference": pose(&other.t_query_reference), "score": other.score }))
        .collect();
    let free_axis = estimate
        .free_axis
        .map(|axis| json!({ "direction": axis.direction.as_slice(), "point": axis.point.as_slice() }));
    json!({
        "alternatives": alternatives,
        "free_axis": free_axis,
        "T_query_reference": pose(&estimate.t_query_reference),
        "score": estimate.score,
        "confidence": estimate.confidence.as_ref().map(|c| c.probability),
        "confident": estimate.confidence.as_ref().map(|c| c.confident),
        "reasons": estimate.confidence.as_ref().map(|c| &c.reasons),
        "overlap": estimate.overlap[0],
        "overlap_reference": estimate.overlap[1],
        "matched": estimate.matched,
        "refined": estimate.refined,
        "T_query_reference_coarse": pose(&estimate.t_query_reference_coarse),
        "timings": estimate.timings,
    })
}

/// The query with the reference's points and axes, and beside it with the reference's own colours.
fn drawn(reference: &Reference, view: &View, results: &[Result<Estimate, InferError>]) -> image::RgbImage {
    let (rgb, camera) = (&view.frame.rgb, &view.frame.intrinsics);
    let mut image = rgb.clone();
    // Every point would hide the image.
    let step = reference.points().len().div_ceil(4000).max(1);
    let points: Vec<[f32; 3]> = reference.points().iter().copied().step_by(step).collect();
    for (estimate, color) in results.iter().flatten().zip(COLORS.into_iter().cycle()) {
        let pose = &estimate.t_query_reference;
        image = overlay::pose_overlay(&image, camera, pose, &points, color);
    }
    let Some(colors) = reference.colors() else { return image };
    let mut painted = rgb.clone();
    for estimate in results.iter().flatten() {
        let pose = &estimate.t_query_reference;
        painted = overlay::painted_overlay(&painted, camera, pose, reference.points(), &colors);
    }
    overlay::contact_sheet(&[image, painted], 2)
}

fn line(files: &ViewFiles, index: usize, estimate: &Estimate) -> String {
    let (r, t) = (estimate.t_query_reference.rotation_row_major(), estimate.t_query_reference.translation);
    let r = r.map(|x| format!("{x:.4}")).join(" ");
    let mask = files.masks.get(index).map(|mask| mask.display().to_string()).unwrap_or_default();
    let confidence = match &estimate.confidence {
        None => "confidence unknown (the checkpoint has no calibration)".into(),
        Some(confidence) if confidence.confident => format!("confidence {:.2}", confidence.probability),
        Some(confidence) => {
            let reasons: Vec<&str> = confidence.reasons.iter().map(|reason| reason.text.as_str()).collect();
            format!("not confident ({:.2}: {})", confidence.probability, reasons.join("; "))
        }
    };
    format!(
        "{mask}: R [{r}] t [{:.4} {:.4} {:.4}] m, score {:.3}, overlap {:.2}, {confidence}, {:.3} s",
        t.x, t.y, t.z, estimate.score, estimate.overlap[0], estimate.timings.total
    )
}

/// What a message about an instance is about.
fn place(files: &ViewFiles, index: usize) -> String {
    let mask = files.masks.get(index).unwrap_or(&files.rgb);
    format!("{} with depth {} and {}", mask.display(), files.depth.display(), files.camera.display())
}
