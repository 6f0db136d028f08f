//! Is an annotated instance usable: does its visible mask show the object, does its depth lie where its pose is?
//!
//! Some published shards have masks that cover everything but the object. They are told by the number of visible pixels
//! that stands beside them, or by how much of the image the object can cover at all in its pose.

use std::fmt;

use nalgebra::{Point3, Vector3};
use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Intrinsics,
};

use super::super::{Instance, ModelInfo};

/// Pixels, and share of the larger number, by which counts of the same mask may differ.
const COUNT_TOLERANCE: (usize, usize) = (16, 10);
/// A mask is foreign when it has more than this many times the recorded pixels ...
const FOREIGN_FACTOR: usize = 2;
/// ... and this many more.
const FOREIGN_PIXELS: usize = 64;
/// Pixels around the outline of an object's bounding sphere: rounding, and a shift between mask and pose.
const REACH_MARGIN: f64 = 3.0;
/// Largest share of a mended mask outside that outline.
const OUTSIDE_SHARE: f64 = 0.02;
/// Fewest measured pixels for a median depth.
const FEWEST_MEASURED: usize = 100;
/// Median depth and origin of an object of unknown size are at most this far apart, metres.
const UNKNOWN_DIAMETER: f64 = 1.0;
/// What depth cameras err at a metre, share of the squared distance.
const DEPTH_ERROR_PER_Z2: f64 = 0.02;

/// Why an annotated instance cannot be used as it is in the files.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum InstanceFault {
    /// The visible mask covered everything but the object. It was inverted; the instance is usable.
    InvertedMask {
        /// Pixels of the mask in the file.
        pixels: usize,
        /// Pixels outside it.
        complement: usize,
        /// `px_count_visib` of the file.
        px_count_visib: u32,
    },
    /// The visible mask does not show the object, and neither does its complement. It was emptied.
    ForeignMask {
        /// Pixels of the mask in the file.
        pixels: usize,
        /// Pixels outside it.
        complement: usize,
        /// `px_count_visib` of the file.
        px_count_visib: u32,
    },
    /// The depth in the mask is not that of the pose. The mask was emptied.
    Depth {
        /// Median of the measured depth in the mask, metres.
        median: f64,
        /// Depth of the object's origin, metres.
        pose: f64,
    },
}

impl InstanceFault {
    /// Whether the instance is usable after all.
    pub fn is_mended(&self) -> bool {
        matches!(self, Self::InvertedMask { .. })
    }
}

impl fmt::Display for InstanceFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InvertedMask { pixels, complement, px_count_visib } => write!(
                f,
                "visible mask is inverted: it has {pixels} pixels and {complement} are outside it, px_count_visib is \
                 {px_count_visib}"
            ),
            Self::ForeignMask { pixels, complement, px_count_visib } => write!(
                f,
                "visible mask does not show the object: it has {pixels} pixels and {complement} are outside it, \
                 px_count_visib is {px_count_visib}"
            ),
            Self::Depth { median, pose } => write!(
                f,
                "median depth in the mask is {median:.3} m, but the pose puts the object at {pose:.3} m"
            ),
        }
    }
}

/// Mends or empties the instance's visible mask where it cannot be right. `model` is known for some objects only.
pub(super) fn mend(
    instance: &mut Instance,
    frame: &RgbdFrame,
    model: Option<&ModelInfo>,
) -> Option<InstanceFault> {
    let mask = &mut instance.mask_visib;
    let pixels = mask.count();
    let (complement, px_count_visib) = (mask.data.len() - pixels, instance.px_count_visib);
    let verdict = {
        let origin = instance.t_camera_object.translation;
        let center = model.map_or(Point3::origin(), |m| Point3::from(m.min + m.size / 2.0));
        let sphere = model.map(|m| (instance.t_camera_object.transform(&center).coords, radius(m)));
        by_count(pixels, complement, px_count_visib as usize)
            .unwrap_or_else(|| by_extent(mask, pixels, &frame.intrinsics, &origin, sphere))
    };
    let fault = match verdict {
        Verdict::Right => wrong_depth(instance, frame, model)?,
        Verdict::Inverted => {
            invert(mask);
            InstanceFault::InvertedMask { pixels, complement, px_count_visib }
        }
        Verdict::Foreign => InstanceFault::ForeignMask { pixels, complement, px_count_visib },
    };
    // An inverted mask of the right size may still lie elsewhere.
    let fault = Some(&fault)
        .filter(|f| f.is_mended())
        .and_then(|_| wrong_depth(instance, frame, model))
        .unwrap_or(fault);
    if !fault.is_mended() {
        instance.mask_visib.data.fill(false);
    }
    Some(fault)
}

/// Sets what is not set and the other way round.
pub(super) fn invert(mask: &mut Mask) {
    mask.data.iter_mut().for_each(|set| *set = !*set);
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    Right,
    Inverted,
    Foreign,
}

/// What the recorded number of visible pixels says; `None` when the mask has about as many.
fn by_count(pixels: usize, complement: usize, recorded: usize) -> Option<Verdict> {
    let near = |count: usize| {
        let (least, share) = COUNT_TOLERANCE;
        count.abs_diff(recorded) <= least.max(recorded.max(count) / share)
    };
    if near(pixels) {
        None
    } else if near(complement) {
        Some(Verdict::Inverted)
    } else if recorded > 0 && pixels > FOREIGN_FACTOR * recorded + FOREIGN_PIXELS {
        Some(Verdict::Foreign)
    } else {
        None
    }
}

/// What the pose says about a mask that covers more than half of the image. `sphere`: centre in the camera frame and
/// radius of a sphere around the object.
fn by_extent(
    mask: &Mask,
    pixels: usize,
    intrinsics: &Intrinsics,
    origin: &Vector3<f64>,
    sphere: Option<(Vector3<f64>, f64)>,
) -> Verdict {
    if 2 * pixels <= mask.data.len() {
        return Verdict::Right;
    }
    let Some((center, radius)) = sphere else {
        // Without a size: a mask up to all borders of the image with a hole where the object's origin is.
        let bounds = mask.bounding_box();
        let to_all_borders = bounds
            .is_some_and(|b| (b.col_min, b.row_min, b.col_max, b.row_max) == (0, 0, mask.width, mask.height));
        let hole = intrinsics.project(&Point3::from(*origin)).is_some_and(|p| {
            let (col, row) = (p.x.round(), p.y.round());
            let inside =
                (0.0..f64::from(mask.width)).contains(&col) && (0.0..f64::from(mask.height)).contains(&row);
            inside && !mask.get(col as u32, row as u32)
        });
        return if to_all_borders && hole { Verdict::Foreign } else { Verdict::Right };
    };
    let Some([cols, rows]) = outline(&center, radius, intrinsics) else { return Verdict::Right };
    let within = |col: u32, row: u32| cols.contains(&f64::from(col)) && rows.contains(&f64::from(row));
    let (mut set_outside, mut unset_outside) = (0usize, 0usize);
    for (i, set) in mask.data.iter().enumerate() {
        if !within((i % mask.width as usize) as u32, (i / mask.width as usize) as u32) {
            *(if *set { &mut set_outside } else { &mut unset_outside }) += 1;
        }
    }
    let complement = mask.data.len() - pixels;
    if 2 * set_outside <= pixels {
        Verdict::Right
    } else if complement > 0 && unset_outside as f64 <= OUTSIDE_SHARE * complement as f64 {
        Verdict::Inverted
    } else {
        Verdict::Foreign
    }
}

/// Columns and rows that a sphere in front of the camera can cover; `None` for one that reaches to the camera.
fn outline(
    center: &Vector3<f64>,
    radius: f64,
    intrinsics: &Intrinsics,
) -> Option<[std::ops::RangeInclusive<f64>; 2]> {
    let (near, far) = (center.z - radius, center.z + radius);
    let slopes = |x: f64| [(x - radius) / near, (x - radius) / far, (x + radius) / near, (x + radius) / far];
    let range = |focal: f64, principal: f64, x: f64| {
        let (low, high) = (
            slopes(x).into_iter().fold(f64::INFINITY, f64::min),
            slopes(x).into_iter().fold(f64::NEG_INFINITY, f64::max),
        );
        focal * low + principal - REACH_MARGIN..=focal * high + principal + REACH_MARGIN
    };
    (near > 0.0).then(|| {
        [range(intrinsics.fx, intrinsics.cx, center.x), range(intrinsics.fy, intrinsics.cy, center.y)]
    })
}

/// Of a sphere around the middle of the object's box; where the box is unknown, around the origin.
fn radius(model: &ModelInfo) -> f64 {
    let half_diagonal = model.size.norm() / 2.0;
    if half_diagonal > 0.0 { half_diagonal } else { model.diameter }
}

/// Depth that belongs to something else, or is in another unit: far more off than any camera or annotation.
fn wrong_depth(instance: &Instance, frame: &RgbdFrame, model: Option<&ModelInfo>) -> Option<InstanceFault> {
    let pose = instance.t_camera_object.translation.z;
    let median = frame.median_depth(&instance.mask_visib, FEWEST_MEASURED)?;
    let limit = model.map_or(0.0, |m| m.diameter).max(UNKNOWN_DIAMETER) + DEPTH_ERROR_PER_Z2 * pose * pose;
    ((median - pose).abs() > limit).then_some(InstanceFault::Depth { median, pose })
}
