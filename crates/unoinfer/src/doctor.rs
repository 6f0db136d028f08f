//! `unoinfer doctor`, and the part of it that `estimate` runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use serde_json::{Value, json};
use unopose_cli::{print_text, say, tell};
use unopose_core::{config::Config, frame::MaskedView};
use unopose_dataset::formats::{FormatError, image_io::MaskValue};
use unopose_doctor::{
    Check, Expected, Finding, Level, MaskedObject, Sampling, bar_length, examine_dataset, findings,
    frame_findings, pair_finding, quick_findings, write_picture,
};
use unopose_eval::report::Table;
use unopose_infer::{View, ViewFiles, ViewRole, query_folder};

use super::options::{CameraOptions, MaskOptions};

/// Findings of every check that a dataset's report lists.
const LISTED: usize = 3;

#[derive(Args)]
pub struct DoctorArguments {
    /// Colour image of the query
    #[arg(long, value_name = "FILE", requires_all = ["query_depth", "camera"])]
    query_rgb: Option<PathBuf>,
    /// Depth image of the query, registered to the colour image
    #[arg(long, value_name = "FILE", requires = "query_rgb")]
    query_depth: Option<PathBuf>,
    /// Mask of an instance in the query; several times for several instances
    #[arg(long, value_name = "FILE", requires = "query_rgb")]
    query_mask: Vec<PathBuf>,
    /// Folder of queries instead, as `estimate` takes it
    #[arg(long, value_name = "DIR", requires = "camera", conflicts_with_all = ["query_rgb", "query_depth", "query_mask"])]
    query_dir: Option<PathBuf>,
    /// Colour image of the reference
    #[arg(long, value_name = "FILE", requires_all = ["reference_depth", "camera"])]
    reference_rgb: Option<PathBuf>,
    /// Depth image of the reference
    #[arg(long, value_name = "FILE", requires = "reference_rgb")]
    reference_depth: Option<PathBuf>,
    /// Mask of the object in the reference
    #[arg(long, value_name = "FILE", requires = "reference_rgb")]
    reference_mask: Option<PathBuf>,
    /// Camera: JSON with cam_K (9 numbers) or fx, fy, cx, cy, and depth_scale (millimetres per depth unit); camera_info of ROS
    /// (YAML); intrinsics of RealSense, Open3D or OpenCV; a text of 3 x 3 numbers. Lens distortion (plumb_bob,
    /// rational_polynomial) is undone
    #[arg(long, value_name = "JSON")]
    camera: Option<PathBuf>,
    #[command(flatten)]
    cameras: CameraOptions,
    #[command(flatten)]
    masks: MaskOptions,
    /// Value or colour of the object in --reference-mask, where it is another one [default: --mask-value]
    #[arg(long, value_name = "N")]
    reference_mask_value: Option<MaskValue>,
    /// Camera of the reference [default: --camera]
    #[arg(long, value_name = "JSON", requires = "camera")]
    reference_camera: Option<PathBuf>,
    /// A BOP dataset or a folder of MegaPose shards instead: samples of it are looked at
    #[arg(long, value_name = "DIR", conflicts_with_all = ["query_rgb", "query_dir", "reference_rgb"])]
    dataset: Option<PathBuf>,
    /// Split of the BOP dataset [default: its test split]
    #[arg(long, requires = "dataset")]
    split: Option<String>,
    /// Camera of its scenes with several, as cam1 in rgb_cam1 and scene_camera_cam1.json
    #[arg(long, value_name = "NAME", requires = "dataset")]
    sensor: Option<String>,
    /// Images of the dataset that are looked at, evenly over the set
    #[arg(long, value_name = "N", default_value_t = 20)]
    images: usize,
    /// Folder for doctor.png
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

/// Ends with an error when something is wrong.
pub fn run(arguments: &DoctorArguments) -> anyhow::Result<()> {
    let model = Config::embedded("geo", &[])?.model;
    let wrong = match &arguments.dataset {
        Some(folder) => {
            let (split, sensor) = (arguments.split.clone(), arguments.sensor.clone());
            let sampling = Sampling { images: arguments.images, split, sensor, points: model.fine_points };
            examine_set(folder, &sampling)?
        }
        None => examine_views(arguments, [model.reference_points, model.fine_points])?,
    };
    if wrong.is_empty() {
        return Ok(());
    }
    bail!("wrong: {}", wrong.join(", "))
}

/// Views that are looked at together, one picture.
fn examine_views(arguments: &DoctorArguments, points: [usize; 2]) -> anyhow::Result<Vec<String>> {
    let mut wrong = Vec::new();
    let reference = match &arguments.reference_rgb {
        Some(rgb) => {
            let files = ViewFiles {
                rgb: rgb.clone(),
                depth: arguments.reference_depth.clone().context("--reference-depth is missing")?,
                masks: arguments.reference_mask.iter().cloned().collect(),
                camera: arguments
                    .reference_camera
                    .as_ref()
                    .or(arguments.camera.as_ref())
                    .context("--camera is missing")?
                    .clone(),
                depth_scale: arguments.cameras.depth_scale,
            };
            let value = arguments.reference_mask_value.or(arguments.masks.mask_value);
            let view = files.read_as(ViewRole::Reference, value);
            examine_view("reference", (&files, view), points[0], None, &mut wrong)
        }
        None => None,
    };
    let object = reference.as_ref().and_then(|view| object(view, 0));
    let queries = queries(arguments)?;
    if queries.is_empty() && reference.is_none() && wrong.is_empty() {
        bail!("nothing to look at: give the files of a query or of a reference, --query-dir or --dataset");
    }
    if queries.is_empty() {
        picture(&arguments.out, reference.as_ref(), None)?;
    }
    for (name, files) in &queries {
        let title = name.as_ref().map_or_else(|| "query".into(), |name| format!("query {name}"));
        let view = files.read_as(ViewRole::Query, arguments.masks.mask_value);
        let query = examine_view(&title, (files, view), points[1], object.as_ref(), &mut wrong);
        let out = name.as_ref().map_or_else(|| arguments.out.clone(), |name| arguments.out.join(name));
        picture(&out, reference.as_ref(), query.as_ref())?;
    }
    Ok(wrong)
}

fn queries(arguments: &DoctorArguments) -> anyhow::Result<Vec<(Option<String>, ViewFiles)>> {
    let camera = || arguments.camera.clone().context("--camera is missing");
    if let Some(folder) = &arguments.query_dir {
        let views = query_folder(folder, &camera()?, arguments.cameras.depth_scale)?;
        return Ok(views.into_iter().map(|(name, files)| (Some(name), files)).collect());
    }
    let Some(rgb) = arguments.query_rgb.clone() else { return Ok(Vec::new()) };
    let depth = arguments.query_depth.clone().context("--query-depth is missing")?;
    let files = ViewFiles {
        rgb,
        depth,
        masks: arguments.query_mask.clone(),
        camera: camera()?,
        depth_scale: arguments.cameras.depth_scale,
    };
    Ok(vec![(None, files)])
}

/// Prints what there is to say about it; what is wrong is added to `wrong`.
fn examine_view(
    title: &str,
    (files, view): (&ViewFiles, Result<View, FormatError>),
    points: usize,
    reference: Option<&MaskedObject>,
    wrong: &mut Vec<String>,
) -> Option<View> {
    let mut report = |place: &str, findings: &[Finding]| {
        say!("{title}: {place}");
        for finding in findings {
            say!("  {}", finding.to_string().replace('\n', "\n  "));
            if finding.level == Level::Wrong {
                wrong.push(format!("{title} ({})", finding.check));
            }
        }
    };
    let view = match view {
        Ok(view) => view,
        Err(error) => {
            let finding = Finding::new(Check::Images, Level::Wrong, unopose_core::explain(&error));
            report(&files.rgb.display().to_string(), &[finding]);
            return None;
        }
    };
    if view.masks.is_empty() {
        report(&format!("{} without a mask", files.rgb.display()), &frame_findings(&view.frame));
    }
    let expected = Expected { depth_scale: view.depth_scale, points };
    for (index, (mask, path)) in view.masks.iter().zip(&files.masks).enumerate() {
        let mut found = findings(MaskedView { frame: &view.frame, mask }, &expected);
        if let (Some(reference), Some(query)) = (reference, object(&view, index)) {
            found.push(pair_finding(reference, &query));
        }
        report(&path.display().to_string(), &found);
    }
    Some(view)
}

fn object(view: &View, mask: usize) -> Option<MaskedObject> {
    MaskedObject::measure(&view.frame.masked_points(view.masks.get(mask)?))
}

/// The reference and the instances of the query, below each other.
fn picture(out: &Path, reference: Option<&View>, query: Option<&View>) -> anyhow::Result<()> {
    let views: Vec<MaskedView<'_>> = [reference, query]
        .into_iter()
        .flatten()
        .flat_map(|view| view.masks.iter().map(|mask| MaskedView { frame: &view.frame, mask }))
        .collect();
    if views.is_empty() {
        return Ok(());
    }
    let path = out.join("doctor.png");
    write_picture(&path, &views)?;
    let bars: Vec<String> = views
        .iter()
        .filter_map(|view| MaskedObject::measure(&view.points()))
        .map(|object| format!("{} cm", (1000.0 * bar_length(&object)).round() / 10.0))
        .collect();
    say!(
        "{}: colour, depth, borders, points from the left and from above (bar: {})",
        path.display(),
        bars.join(", ")
    );
    Ok(())
}

fn examine_set(folder: &Path, sampling: &Sampling) -> anyhow::Result<Vec<String>> {
    let report = examine_dataset(folder, sampling)?;
    if report.instances.is_empty() {
        bail!(
            "{}: no annotated instance in {} images that is visible enough",
            folder.display(),
            report.images
        );
    }
    let mut table = Table::new(["check", "verdict", "ok", "look", "wrong"]);
    let summaries = report.summaries();
    for summary in &summaries {
        let [ok, look, wrong] = summary.counts.map(|n| n.to_string());
        table.push([summary.check.to_string(), summary.level.to_string(), ok, look, wrong]);
    }
    say!("{}: {} instances in {} images", folder.display(), report.instances.len(), report.images);
    print_text(&table.to_string());
    for (place, finding) in report.worst(LISTED) {
        say!("{place}\n  {}", finding.to_string().replace('\n', "\n  "));
    }
    Ok(summaries.iter().filter(|s| s.level == Level::Wrong).map(|s| s.check.to_string()).collect())
}

/// A finding that is not ok, for `pose.json`.
pub type Warning = Value;

/// The quick findings of a masked object that are not ok, printed to standard error; an error where the unit of depth must be
/// wrong. `view` names it: `reference`, or a mask.
pub fn warnings(
    view: &str,
    seen: MaskedView<'_>,
    expected: &Expected,
    reference: Option<&MaskedObject>,
) -> anyhow::Result<(Option<MaskedObject>, Vec<Warning>)> {
    let object = MaskedObject::measure(&seen.points());
    let mut found = quick_findings(seen, expected);
    if let (Some(reference), Some(query)) = (reference, &object) {
        found.push(pair_finding(reference, query));
    }
    let mut warnings = Vec::new();
    for finding in found.iter().filter(|finding| finding.level > Level::Ok) {
        if finding.level == Level::Wrong && matches!(finding.check, Check::Unit | Check::Pair) {
            bail!("{view}: {}; {}", finding.text, finding.advice);
        }
        tell!("warning: {view}: {}; {}", finding.text, finding.advice);
        let mut warning = json!(finding);
        warning["view"] = json!(view);
        warnings.push(warning);
    }
    Ok((object, warnings))
}

/// What a warning says about the unit of depth, if it does.
pub fn unit_doubt(warning: &Warning) -> Option<String> {
    let is_unit = [Check::Unit, Check::Pair].iter().any(|check| warning["check"] == json!(check));
    is_unit.then(|| {
        format!(
            "{}; {}",
            warning["text"].as_str().unwrap_or_default(),
            warning["advice"].as_str().unwrap_or_default()
        )
    })
}
