//! What a run shows of itself: `curves.svg` from the journal, `poses.png` from validation pairs.

use std::path::Path;

use burn::tensor::Device;
use image::Rgb;
use nalgebra::Point3;
use unopose_core::{config::Config, frame::RgbdFrame, geometry::Pose};
use unopose_eval::report::{Curve, Panel, overlay, smoothed, write_curves};
use unopose_nn::model::UnoPose;
use unopose_pairs::data::CloudInput;

use super::{
    TrainError,
    journal::Event,
    validation::{Validation, estimate, true_pose},
};

/// Colour of points and axes under the estimated pose.
const PREDICTED: Rgb<u8> = Rgb([255, 170, 0]);
/// Colour of points and axes under the true pose.
const TRUE: Rgb<u8> = Rgb([0, 200, 120]);
/// Side of a tile, pixels.
const TILE: u32 = 200;
/// Pairs on the sheet, the first of the validation.
const SHOWN_PAIRS: usize = 8;

/// Losses, shares of good poses and rotation error (or the features' ROC area) and learning rate over steps.
pub fn write_training_curves(path: &Path, events: &[Event]) -> Result<(), TrainError> {
    let steps = |value: fn(&super::journal::StepRecord) -> f64| -> Vec<(f64, f64)> {
        let of = |event: &Event| match event {
            Event::Step(record) => Some((record.step as f64, value(record))),
            Event::Validation(_) => None,
        };
        events.iter().filter_map(of).collect()
    };
    let validations = |value: fn(&super::journal::ValidationRecord) -> f64| -> Vec<(f64, f64)> {
        let of = |event: &Event| match event {
            Event::Validation(record) => Some((record.step as f64, value(record))),
            Event::Step(_) => None,
        };
        events.iter().filter_map(of).collect()
    };
    let curve = |label: &str, points| Curve { label: label.into(), points, faint: false };
    let loss = steps(|r| r.loss);
    // At most about 2000 points in the background line, 150 in the smoothed one.
    let raw = smoothed(&loss, loss.len().div_ceil(2000));
    let smooth = smoothed(&loss, loss.len().div_ceil(150));
    let mut panels = vec![Panel {
        title: "loss".into(),
        curves: vec![
            Curve { label: "training".into(), points: raw, faint: true },
            curve("training, smoothed", smooth),
            curve("validation", validations(|r| r.loss)),
        ],
        range: None,
    }];
    let recall = |value: fn(&super::journal::ProposalRecall) -> f64| -> Vec<(f64, f64)> {
        let of = |event: &Event| match event {
            Event::Validation(record) => Some((record.step as f64, value(record.proposals.as_ref()?))),
            Event::Step(_) => None,
        };
        events.iter().filter_map(of).collect()
    };
    let areas = validations(|r| r.roc_area.unwrap_or(f64::NAN));
    if areas.iter().any(|(_, area)| area.is_finite()) {
        panels.push(Panel {
            title: "validation: area under the ROC curve of the features".into(),
            curves: vec![curve("same points against others", areas)],
            range: None,
        });
    } else if !recall(|r| r.recall_50).is_empty() {
        panels.push(Panel {
            title: "validation: proposals".into(),
            curves: vec![
                curve("recall at 0.5", recall(|r| r.recall_50)),
                curve("recall at 0.75", recall(|r| r.recall_75)),
                curve("mean overlap", recall(|r| r.mean_iou)),
            ],
            range: Some((0.0, 1.0)),
        });
    } else {
        panels.extend([
            Panel {
                title: "validation: share of pairs".into(),
                curves: vec![
                    curve("within 5 deg and 5 cm", validations(|r| r.within_5deg_5cm)),
                    curve("within 15 deg", validations(|r| r.within_15deg)),
                    curve("within 15 deg, coarse stage", validations(|r| r.coarse_within_15deg)),
                    curve(
                        "within 15 deg, print decides",
                        validations(|r| r.print_within_15deg.unwrap_or(f64::NAN)),
                    ),
                    curve("average recall", validations(|r| r.average_recall.unwrap_or(f64::NAN))),
                ],
                range: Some((0.0, 1.0)),
            },
            Panel {
                title: "validation: median rotation error, degrees".into(),
                curves: vec![curve("rotation", validations(|r| r.median_rotation_deg))],
                range: None,
            },
        ]);
    }
    panels.push(Panel {
        title: "learning rate".into(),
        curves: vec![curve("learning rate", {
            let rate = steps(|r| r.learning_rate);
            smoothed(&rate, rate.len().div_ceil(500))
        })],
        range: None,
    });
    Ok(write_curves(path, "step", &panels)?)
}

/// One row of three tiles per pair: the reference with its points, the query with the predicted and with the true
/// pose.
pub fn write_pose_sheet(
    path: &Path,
    model: &UnoPose,
    config: &Config,
    validation: &Validation,
    device: &Device,
) -> Result<(), TrainError> {
    let samples = validation.samples(0..validation.truths().len().min(SHOWN_PAIRS))?;
    let mut tiles = Vec::new();
    for (index, sample) in samples.iter().enumerate() {
        let estimates = estimate(model, config, std::slice::from_ref(sample), index as u64, device)?;
        let Some(estimate) = estimates.first() else { continue };
        let truth = true_pose(sample);
        let reference = validation.source().load(sample.key.reference_image)?;
        let query = validation.source().load(sample.key.query_image)?;
        let cloud = metric_points(&sample.reference.cloud, sample.reference.radius);
        let pose = [Pose::identity(), estimate.t_query_reference, truth];
        let frames = [&reference.frame, &query.frame, &query.frame];
        for ((t, frame), color) in pose.iter().zip(frames).zip([TRUE, PREDICTED, TRUE]) {
            let place = if std::ptr::eq(frame, &reference.frame) { &pose[0] } else { &truth };
            tiles.push(tile(frame, t, place, &cloud, color));
        }
    }
    Ok(overlay::write_png(path, &overlay::contact_sheet(&tiles, 6))?)
}

/// The part of the image around the points under `place`, with the points and axes under `t` on it.
fn tile(frame: &RgbdFrame, t: &Pose, place: &Pose, cloud: &[[f32; 3]], color: Rgb<u8>) -> image::RgbImage {
    let drawn = overlay::pose_overlay(&frame.rgb, &frame.intrinsics, t, cloud, color);
    let pixels = cloud.iter().filter_map(|p| {
        let [x, y, z] = place.transform_f32(p).map(f64::from);
        frame.intrinsics.project(&Point3::new(x, y, z))
    });
    let start = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let [left, right, top, bottom] = pixels.fold(start, |[left, right, top, bottom], p| {
        [left.min(p.x), right.max(p.x), top.min(p.y), bottom.max(p.y)]
    });
    let center = ((left + right) / 2.0, (top + bottom) / 2.0);
    let half = 0.5 * (right - left).max(bottom - top);
    if !(half.is_finite() && center.0.is_finite()) {
        return overlay::cutout(&drawn, (0.0, 0.0), f64::from(drawn.width()), TILE);
    }
    overlay::cutout(&drawn, center, 1.6 * half.max(8.0), TILE)
}

/// Points of a prepared cloud in its camera, metres.
fn metric_points(cloud: &CloudInput, radius: f32) -> Vec<[f32; 3]> {
    let scale = radius + 1e-6;
    cloud.points.iter().map(|p| std::array::from_fn(|i| p[i] * scale + cloud.center[i])).collect()
}
