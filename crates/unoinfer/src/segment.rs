//! `unoinfer segment`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use unopose_cli::say;
use unopose_core::{
    frame::{BoundingBox, DepthMap, Mask, MaskedView, RgbdFrame},
    geometry::Intrinsics,
};
use unopose_dataset::formats::{
    FormatError,
    camera::read_camera_scaled,
    detections::write_detections,
    image_io::{read_depth_by, read_rgb, write_mask},
};
use unopose_eval::report::overlay;
use unopose_infer::{ViewFiles, ViewRole};
use unopose_segment::{AnyMatcher, Prompt, Proposal, SegmentError};

use super::{
    mask_finder::MaskFinder,
    options::{CameraOptions, EstimatorOptions, MaskOptions, SplitOptions},
    proposals::ProposalOptions,
    segment_dataset::{DatasetFiles, segment_dataset},
};

#[derive(Args)]
pub struct SegmentArguments {
    /// Colour image: png, jpeg, webp, tiff or bmp
    #[arg(long, value_name = "FILE", required_unless_present = "dataset")]
    rgb: Option<PathBuf>,
    /// Depth image, registered to the colour image: 16-bit png, tiff or pgm, npy; or floats in metres: tiff, OpenEXR, npy,
    /// pfm [default: colour alone]
    #[arg(long, value_name = "FILE", requires = "camera")]
    depth: Option<PathBuf>,
    /// Camera: JSON with cam_K (9 numbers) or fx, fy, cx, cy, and depth_scale (millimetres per depth unit); camera_info of ROS
    /// (YAML); intrinsics of RealSense, Open3D or OpenCV; a text of 3 x 3 numbers. The images
    /// have to be undistorted ones
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Write the mask of what is at this pixel, to OUT/mask.png
    #[arg(long, value_name = "X,Y", value_delimiter = ',', num_args = 1, conflicts_with_all = ["box", "dataset"])]
    point: Vec<u32>,
    /// Write the mask of what this box is around, to OUT/mask.png
    #[arg(long, value_name = "X,Y,W,H", value_delimiter = ',', num_args = 1, conflicts_with = "dataset")]
    r#box: Vec<u32>,
    /// Find the object of a reference: its colour image
    #[arg(long, value_name = "FILE", requires_all = ["reference_depth", "reference_mask", "camera", "depth"])]
    reference_rgb: Option<PathBuf>,
    /// Its depth image
    #[arg(long, value_name = "FILE")]
    reference_depth: Option<PathBuf>,
    /// Its mask
    #[arg(long, value_name = "FILE")]
    reference_mask: Option<PathBuf>,
    #[command(flatten)]
    masks: MaskOptions,
    /// Camera of the reference [default: --camera]
    #[arg(long, value_name = "FILE")]
    reference_camera: Option<PathBuf>,
    #[command(flatten)]
    cameras: CameraOptions,
    /// BOP dataset folder: find the objects of --targets in all their images and score the detections
    #[arg(long, value_name = "DIR", requires = "targets", conflicts_with = "rgb")]
    dataset: Option<PathBuf>,
    /// Targets with their reference views: scene_id, im_id, obj_id, ref_scene_id, ref_im_id
    #[arg(long, value_name = "JSON")]
    targets: Option<PathBuf>,
    #[command(flatten)]
    splits: SplitOptions,
    /// Only the first N entries of the target list
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// DINOv2 weights by which proposals are compared with the reference: ViT-S, B or L with or without registers,
    /// safetensors or PyTorch [default: the pose network's checkpoint compares]
    #[arg(long, value_name = "FILE")]
    descriptor: Option<PathBuf>,
    /// With --dataset and --descriptor: N templates of each object's CAD model instead of its reference view (12, 42 or 162)
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "42", requires = "descriptor", conflicts_with = "rgb")]
    templates: Option<usize>,
    #[command(flatten)]
    proposals: ProposalOptions,
    /// Folder for masks.json and masks.png, or for detections.json, proposals.json and scores.json
    #[arg(long, value_name = "DIR", default_value = "segment")]
    out: PathBuf,
    #[command(flatten)]
    estimator: EstimatorOptions,
}

pub fn run(arguments: &SegmentArguments) -> anyhow::Result<()> {
    let generator = arguments.proposals.generator(arguments.estimator.device())?;
    if let (Some(dataset), Some(targets)) = (&arguments.dataset, &arguments.targets) {
        let files = DatasetFiles {
            splits: arguments.splits.of(dataset),
            targets: targets.clone(),
            limit: arguments.limit,
            templates: arguments.templates,
        };
        let estimator = arguments.estimator.estimator()?;
        let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
        return segment_dataset(&files, generator.as_ref(), &matcher, &arguments.out).map(drop);
    }
    let frame = frame(arguments)?;
    let path = arguments.rgb.clone().context("--rgb is missing")?;
    if let Some(reference) = reference_files(arguments) {
        let view = reference.read_as(ViewRole::Reference, arguments.masks.mask_value)?;
        let mask = view.masks.first().context("no reference mask")?;
        let estimator = arguments.estimator.estimator()?;
        let matcher = AnyMatcher::choose(arguments.descriptor.as_deref(), &estimator)?;
        let reference = MaskedView { frame: &view.frame, mask };
        let finder = MaskFinder::new(generator.as_ref(), &matcher, reference)?;
        let found = finder.find(&frame, &path)?;
        let instances: Vec<_> = found.instances.iter().map(|(proposal, score)| (proposal, *score)).collect();
        return write(&arguments.out, &frame, &instances, found.seconds);
    }
    if arguments.descriptor.is_some() {
        bail!("--descriptor compares with a reference: expected --reference-rgb or --dataset");
    }
    let start = std::time::Instant::now();
    if let Some(prompt) = prompt(arguments)? {
        let chosen = generator.segment_prompt(&frame, prompt)?;
        let mask = arguments.out.join("mask.png");
        write_mask(&mask, &chosen.mask)?;
        say!("{}: {} pixels", mask.display(), chosen.mask.count());
        let masks = [(&chosen, f64::from(chosen.score))];
        return write(&arguments.out, &frame, &masks, start.elapsed().as_secs_f64());
    }
    let proposals = generator.proposals(&frame, None)?;
    let seconds = start.elapsed().as_secs_f64();
    if proposals.is_empty() {
        let image = path.display().to_string();
        return Err(SegmentError::NotFound { image, proposals: 0, best: None }.into());
    }
    let all: Vec<_> = proposals.iter().map(|p| (p, f64::from(p.score))).collect();
    write(&arguments.out, &frame, &all, seconds)
}

/// The image, with zero depth where there is no depth image.
fn frame(arguments: &SegmentArguments) -> anyhow::Result<RgbdFrame> {
    let path = arguments.rgb.as_ref().context("--rgb is missing")?;
    let rgb = read_rgb(path)?;
    let (width, height) = rgb.dimensions();
    let camera = match &arguments.camera {
        Some(path) => Some((path, read_camera_scaled(path, arguments.cameras.depth_scale)?)),
        None => None,
    };
    let depth = match (&arguments.depth, &camera) {
        (Some(depth), Some((path, camera))) => read_depth_by(depth, || camera.require_depth_scale(path))?,
        _ => DepthMap::zeros(width, height),
    };
    if let Some((path, camera)) = &camera {
        let place = path.display().to_string();
        camera.check_size(&place, (width, height))?;
        if camera.undistortion(&place, (width, height))?.is_some() {
            let expected = "none: the masks are to be those of the image as it is given";
            return Err(FormatError::field(place, "lens distortion", "one that is not 0", expected).into());
        }
    }
    if let (Some(path), true) = (&arguments.depth, (depth.width, depth.height) != (width, height)) {
        let size = format!("{} x {}", depth.width, depth.height);
        let expected = format!("{width} x {height} like the colour image");
        return Err(FormatError::field(path.display(), "depth image size", size, expected).into());
    }
    // Without depth nothing is back-projected.
    let side = f64::from(width.max(height));
    let centre = Intrinsics { fx: side, fy: side, cx: f64::from(width) / 2.0, cy: f64::from(height) / 2.0 };
    Ok(RgbdFrame { rgb, depth, intrinsics: camera.map_or(centre, |(_, camera)| camera.intrinsics) })
}

fn reference_files(arguments: &SegmentArguments) -> Option<ViewFiles> {
    Some(ViewFiles {
        rgb: arguments.reference_rgb.clone()?,
        depth: arguments.reference_depth.clone()?,
        masks: vec![arguments.reference_mask.clone()?],
        camera: arguments.reference_camera.clone().or_else(|| arguments.camera.clone())?,
        depth_scale: arguments.cameras.depth_scale,
    })
}

fn prompt(arguments: &SegmentArguments) -> anyhow::Result<Option<Prompt>> {
    Ok(match (arguments.point.as_slice(), arguments.r#box.as_slice()) {
        ([], []) => None,
        (&[col, row], []) => Some(Prompt::Point(col, row)),
        ([], &[x, y, w, h]) => Some(Prompt::Box(BoundingBox {
            col_min: x,
            row_min: y,
            col_max: x.saturating_add(w),
            row_max: y.saturating_add(h),
        })),
        (point, &[]) => bail!("--point has {} numbers, expected X,Y", point.len()),
        (_, numbers) => bail!("--box has {} numbers, expected X,Y,W,H", numbers.len()),
    })
}

/// `masks.json` in the form of detections and `masks.png`, the masks on the image.
fn write(out: &Path, frame: &RgbdFrame, masks: &[(&Proposal, f64)], seconds: f64) -> anyhow::Result<()> {
    let list: Vec<_> = masks.iter().map(|(p, score)| p.detection(0, 0, 0, *score, seconds)).collect();
    write_detections(&out.join("masks.json"), &list)?;
    let drawn: Vec<&Mask> = masks.iter().map(|(p, _)| &p.mask).collect();
    overlay::write_png(&out.join("masks.png"), &overlay::mask_overlay(&frame.rgb, &drawn))?;
    for (proposal, score) in masks.iter().take(10) {
        let b = &proposal.bounds;
        let size = [b.col_max - b.col_min, b.row_max - b.row_min];
        say!("score {score:.3}, box {},{},{},{}", b.col_min, b.row_min, size[0], size[1]);
    }
    say!("{} masks in {seconds:.3} s: {} and masks.png", masks.len(), out.join("masks.json").display());
    Ok(())
}
