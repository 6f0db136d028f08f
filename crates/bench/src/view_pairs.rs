//! Single pairs of views with a known relative pose, as real recordings give them: no models, no scenes.

use std::{fmt, io::Write, path::Path};

use image::RgbImage;
use nalgebra::Point3;
use serde::Serialize;
use unopose_core::{
    files::write_atomic,
    frame::{BoundingBox, Mask, MaskedView},
    geometry::{Pose, nearest_distances},
};
use unopose_dataset::formats::files::write_json;
use unopose_eval::report::overlay::{contact_sheet, cutout, painted_overlay, pose_overlay, write_png};
use unopose_infer::PoseCriterion;
use unopose_pairs::registration::{PairEstimator, Refined, Refinement};

use super::{
    BenchError, Method,
    view_list::{OwnMasks, PairViews, ViewPair},
};

/// Mean distance between the surfaces in two poses, diameters, up to which they are the same shape in the same place.
const SAME_SHAPE: f64 = 0.04;
/// Points that the distance is measured with.
const SHAPE_POINTS: usize = 800;
/// Side of a picture on the sheet, pixels.
const TILE: u32 = 200;
const COLOR: image::Rgb<u8> = image::Rgb([255, 170, 0]);

/// How right a pose is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within 15 degrees and a tenth of the diameter.
    Right,
    /// The surface lies where it should, but turned: the print is wrong.
    PrintWrong,
    /// Neither.
    Wrong,
    /// No pose.
    NoPose,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Right => "right",
            Self::PrintWrong => "print wrong",
            Self::Wrong => "wrong",
            Self::NoPose => "no pose",
        })
    }
}

/// A pair's result.
#[derive(Clone, Debug, Serialize)]
pub struct PairResult {
    /// Object, reference and query of the list.
    pub object: String,
    /// Folder of the reference view.
    pub reference: String,
    /// Folder of the query view.
    pub query: String,
    /// Rotation between the views, degrees.
    pub true_rotation_deg: f64,
    /// Error of the rotation, degrees, and of the position of the reference surface's middle, diameters; `None` without a pose.
    pub rotation_deg: Option<f64>,
    /// See [`Self::rotation_deg`].
    pub translation: Option<f64>,
    /// Mean distance between the surfaces in the estimated and in the true pose, diameters.
    pub shape: Option<f64>,
    /// How right it is.
    pub verdict: Verdict,
    /// Calibrated probability, and whether the estimate is confident.
    pub confidence: Option<(f64, bool)>,
    /// Why there is no pose.
    pub error: Option<String>,
}

/// All pairs with one method.
#[derive(Clone, Debug, Serialize)]
pub struct PairsRun {
    /// With its refinement.
    pub method: String,
    /// In the order of the list.
    pub pairs: Vec<PairResult>,
}

impl PairsRun {
    /// Pairs with a verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.pairs.iter().filter(|pair| pair.verdict == verdict).count()
    }
}

/// Runs every method with every refinement on a list of pairs (`object`, `reference`, `query`, `T_query_reference`; the
/// views are folders beside it with `rgb`, `depth`, `camera.json`, `mask_OBJECT`). With `own_masks` the query's masks are not
/// read but found. Writes `pairs.json`, `pairs.md` and a sheet
/// `METHOD.png` per method: reference, query, and the query with the reference's own colours in the estimated pose.
pub fn run_pairs(
    list: &Path,
    own_masks: Option<&OwnMasks<'_>>,
    methods: &[Method],
    refinements: &[Refinement],
    folder: &Path,
    progress: &dyn Fn(&str, usize, usize),
) -> Result<Vec<PairsRun>, BenchError> {
    let mut pairs = PairViews::open(list, own_masks)?;
    let mut runs = Vec::new();
    for method in methods {
        for &refinement in refinements {
            let method = Refined { estimator: method.estimator.as_ref(), refinement };
            let (mut results, mut tiles) = (Vec::new(), Vec::new());
            for done in 0..pairs.len() {
                progress(&method.name(), done, pairs.len());
                let (result, drawn) = run(&pairs.pair(done)?, &method)?;
                results.push(result);
                tiles.extend(drawn);
            }
            progress(&method.name(), pairs.len(), pairs.len());
            write_png(&folder.join(format!("{}.png", method.name())), &contact_sheet(&tiles, 6))?;
            runs.push(PairsRun { method: method.name(), pairs: results });
        }
    }
    write_json(&folder.join("pairs.json"), &runs, true)?;
    let text = pairs_table(&runs);
    write_atomic(&folder.join("pairs.md"), |out| out.write_all(text.as_bytes()))?;
    Ok(runs)
}

fn run(pair: &ViewPair, method: &Refined<'_>) -> Result<(PairResult, [RgbImage; 3]), BenchError> {
    let ViewPair { listed: pair, truth, reference: (reference, reference_mask), query, query_mask } = pair;
    let reference_view = MaskedView { frame: reference, mask: reference_mask };
    let estimate = match query_mask {
        Ok(mask) => {
            let estimate = method.estimate(MaskedView { frame: query, mask }, reference_view);
            estimate.map_err(|error| error.to_string())
        }
        Err(reason) => Err(reason.clone()),
    };
    let points = reference_view.points();
    let mut result = PairResult {
        object: pair.object.clone(),
        reference: pair.reference.clone(),
        query: pair.query.clone(),
        true_rotation_deg: truth.rotation_angle_deg(&Pose::identity()),
        rotation_deg: None,
        translation: None,
        shape: None,
        verdict: Verdict::NoPose,
        confidence: None,
        error: None,
    };
    let pose = match estimate {
        Ok(found) => {
            let pose = found.t_query_reference;
            let measured = Measured::new(&pose, truth, &points);
            result.verdict = measured.verdict(pair.symmetry.contains('+'));
            result.rotation_deg = Some(measured.rotation_deg);
            result.translation = Some(measured.translation);
            result.shape = Some(measured.shape);
            result.confidence = found.confidence;
            Some(pose)
        }
        Err(error) => {
            result.error = Some(error);
            None
        }
    };
    let colors: Vec<[u8; 3]> = reference
        .measured_pixels(reference_mask)
        .map(|(col, row, _)| reference.rgb.get_pixel(col, row).0)
        .collect();
    let drawn = match &pose {
        Some(pose) => painted_overlay(&query.rgb, &query.intrinsics, pose, &points, &colors),
        None => query.rgb.clone(),
    };
    let outlined = match &pose {
        Some(pose) => pose_overlay(&query.rgb, &query.intrinsics, pose, &[], COLOR),
        None => query.rgb.clone(),
    };
    let part = |image: &RgbImage, mask: Option<&Mask>| {
        let (width, height) = image.dimensions();
        // Without a mask the whole image.
        let whole = BoundingBox { col_min: 0, row_min: 0, col_max: width, row_max: height };
        let b = mask.and_then(Mask::bounding_box).unwrap_or(whole);
        let middle = |low: u32, high: u32| f64::from(low + high) / 2.0;
        let longer = (b.col_max - b.col_min).max(b.row_max - b.row_min);
        let center = (middle(b.col_min, b.col_max), middle(b.row_min, b.row_max));
        cutout(image, center, f64::from(longer) * 0.65 + 8.0, TILE)
    };
    let query_mask = query_mask.as_ref().ok();
    let tiles =
        [part(&reference.rgb, Some(reference_mask)), part(&outlined, query_mask), part(&drawn, query_mask)];
    Ok((result, tiles))
}

/// Errors of a pose.
struct Measured {
    rotation_deg: f64,
    /// Diameters.
    translation: f64,
    /// Diameters.
    shape: f64,
}

impl Measured {
    fn new(pose: &Pose, truth: &Pose, points: &[[f32; 3]]) -> Self {
        let step = points.len().div_ceil(SHAPE_POINTS).max(1);
        let some: Vec<[f32; 3]> = points.iter().copied().step_by(step).collect();
        let mean = some.iter().fold(Point3::origin(), |sum, p| {
            sum + Point3::from(p.map(|x| f64::from(x) / some.len() as f64)).coords
        });
        let radius = |p: &[f32; 3]| (Point3::from(p.map(f64::from)) - mean).norm();
        let diameter = 2.0 * some.iter().map(radius).fold(1e-6, f64::max);
        let moved = |pose: &Pose| -> Vec<[f32; 3]> { some.iter().map(|p| pose.transform_f32(p)).collect() };
        let (found, expected) = (moved(pose), moved(truth));
        let distances = nearest_distances(&found, &expected);
        let shape = distances.iter().map(|&d| f64::from(d)).sum::<f64>() / distances.len().max(1) as f64;
        Self {
            rotation_deg: pose.rotation_angle_deg(truth),
            translation: (pose.transform(&mean) - truth.transform(&mean)).norm() / diameter,
            shape: shape / diameter,
        }
    }

    fn verdict(&self, only_the_shape_counts: bool) -> Verdict {
        let PoseCriterion { rotation_deg, translation } = PoseCriterion::DEFAULT;
        let same_shape = self.shape < SAME_SHAPE;
        if self.rotation_deg < rotation_deg && self.translation < translation
            || only_the_shape_counts && same_shape
        {
            Verdict::Right
        } else if same_shape {
            Verdict::PrintWrong
        } else {
            Verdict::Wrong
        }
    }
}

/// The table of all runs, as Markdown.
pub fn pairs_table(runs: &[PairsRun]) -> String {
    let mut text = String::new();
    for run in runs {
        text += &format!(
            "\n### {}\n\n| object | reference | query | apart | error | offset | shape | verdict | confidence |\n",
            run.method
        );
        text += "|--|--|--|--|--|--|--|--|--|\n";
        for pair in &run.pairs {
            let number = |value: Option<f64>, unit: &str, digits: usize| {
                value.map_or_else(|| "-".into(), |v| format!("{v:.digits$}{unit}"))
            };
            let confidence = pair.confidence.map_or_else(
                || "-".into(),
                |(p, sure)| format!("{p:.2}{}", if sure { ", confident" } else { "" }),
            );
            text += &format!(
                "| {} | {} | {} | {:.0} deg | {} | {} | {} | {} | {confidence} |\n",
                pair.object,
                pair.reference,
                pair.query,
                pair.true_rotation_deg,
                number(pair.rotation_deg, " deg", 1),
                number(pair.translation, " d", 3),
                number(pair.shape, " d", 3),
                pair.error.clone().unwrap_or_else(|| pair.verdict.to_string()),
            );
        }
        let of = |verdict| run.count(verdict);
        let sure = |right: bool| {
            let counts = |pair: &&PairResult| {
                (pair.verdict == Verdict::Right) == right && pair.confidence.is_some_and(|(_, sure)| sure)
            };
            run.pairs.iter().filter(counts).count()
        };
        text += &format!(
            "\n{}: {} of {} right, {} with a wrong print, {} wrong, {} without a pose; confident: {} of the right ones, {} of \
             the others\n",
            run.method,
            of(Verdict::Right),
            run.pairs.len(),
            of(Verdict::PrintWrong),
            of(Verdict::Wrong),
            of(Verdict::NoPose),
            sure(true),
            sure(false),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::*;

    /// Half of a can of 4 cm radius around the y axis.
    fn can() -> Vec<[f32; 3]> {
        (0..2000)
            .map(|i| {
                let angle = (i % 50) as f32 / 50.0 * std::f32::consts::TAU;
                [0.04 * angle.sin(), 0.1 * (i / 50) as f32 / 40.0 - 0.05, 0.04 * angle.cos()]
            })
            .collect()
    }

    #[test]
    fn a_turned_can_has_the_right_shape_and_the_wrong_print() {
        let about_y = |degrees: f64, shift: f64| {
            let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), degrees.to_radians());
            Pose::new(*turn.matrix(), Vector3::new(shift, 0.0, 0.0))
        };
        let verdict = |degrees, shift, only_shape| {
            Measured::new(&about_y(degrees, shift), &Pose::identity(), &can()).verdict(only_shape)
        };
        assert_eq!(verdict(10.0, 0.0, false), Verdict::Right);
        assert_eq!(verdict(90.0, 0.0, false), Verdict::PrintWrong);
        assert_eq!(verdict(90.0, 0.0, true), Verdict::Right);
        assert_eq!(verdict(0.0, 0.03, false), Verdict::Wrong);
        let measured = Measured::new(&about_y(90.0, 0.0), &Pose::identity(), &can());
        assert!((measured.rotation_deg - 90.0).abs() < 1e-6 && measured.shape < SAME_SHAPE);
    }
}
