//! Methods on a phone sequence: one frame is the reference, the others are queries, and the camera poses tell the truth.

use std::{io::Write as _, path::Path};

use nalgebra::Vector3;
use serde::Serialize;
use unopose_core::{files::write_atomic, frame::MaskedView, geometry::Pose};
use unopose_dataset::formats::{FormatError, PhoneSequence, files::write_json};
use unopose_pairs::registration::{PairEstimator, Refined, Refinement};

use super::{
    BenchError,
    cells::{percent, seconds},
    section::Section,
    suite::Method,
};

/// Errors of one query frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct FrameError {
    pub(crate) frame: u32,
    /// `None` without a pose, with the reason.
    pub(crate) rotation_deg: Option<f64>,
    /// Of the centre of the reference's points, metres.
    pub(crate) translation: Option<f64>,
    pub(crate) seconds: Option<f64>,
    pub(crate) reason: Option<String>,
}

/// One method on a sequence.
#[derive(Clone, Debug, Serialize)]
pub struct SequenceRun {
    pub(crate) method: String,
    pub(crate) frames: Vec<FrameError>,
    /// Mean, a frame without a pose counting as 180 degrees.
    pub(crate) angular_error_deg: f64,
    #[serde(rename = "Acc15")]
    pub(crate) acc15: f64,
    #[serde(rename = "Acc30")]
    pub(crate) acc30: f64,
    /// Share of the frames within 5 degrees and 5 cm.
    pub(crate) within_5deg_5cm: f64,
    /// Mean over the frames with a pose; -1 without any.
    pub(crate) mean_time_per_pair_s: f64,
    pub(crate) without_pose: usize,
}

/// Every method with every refinement on every `step`-th frame but the reference; writes `sequence.json` and
/// `sequence.md` into `folder`.
pub fn run_sequence(
    sequence: &PhoneSequence,
    reference: u32,
    step: usize,
    methods: &[Method],
    refinements: &[Refinement],
    folder: &Path,
) -> Result<Vec<SequenceRun>, BenchError> {
    let queries: Vec<u32> = sequence.frame_ids().filter(|&id| id != reference).step_by(step.max(1)).collect();
    let mut runs = Vec::new();
    for method in methods {
        for &refinement in refinements {
            let refined = Refined { estimator: method.estimator.as_ref(), refinement };
            runs.push(run(sequence, reference, &queries, &refined)?);
        }
    }
    write_json(&folder.join("sequence.json"), &runs, true)?;
    let text = sequence_table(&sequence.name(), reference, &runs);
    write_atomic(&folder.join("sequence.md"), |out| out.write_all(text.as_bytes()))?;
    Ok(runs)
}

fn run(
    sequence: &PhoneSequence,
    reference: u32,
    queries: &[u32],
    method: &Refined,
) -> Result<SequenceRun, FormatError> {
    let (frame, mask) = sequence.load(reference)?;
    let reference_view = MaskedView { frame: &frame, mask: &mask };
    let center = mean(&reference_view.points());
    let mut frames = Vec::new();
    for &id in queries {
        let (frame, mask) = sequence.load(id)?;
        let truth = sequence.relative_pose(id, reference)?;
        let estimate = method.estimate(MaskedView { frame: &frame, mask: &mask }, reference_view);
        let at = |pose: &Pose| pose.rotation * center + pose.translation;
        frames.push(match estimate {
            Ok(pair) => FrameError {
                frame: id,
                rotation_deg: Some(pair.t_query_reference.rotation_angle_deg(&truth)),
                translation: Some((at(&pair.t_query_reference) - at(&truth)).norm()),
                seconds: Some(pair.seconds),
                reason: None,
            },
            Err(error) => FrameError {
                frame: id,
                rotation_deg: None,
                translation: None,
                seconds: None,
                reason: Some(error.to_string()),
            },
        });
    }
    Ok(SequenceRun::new(method.name(), frames))
}

impl SequenceRun {
    fn new(method: String, frames: Vec<FrameError>) -> Self {
        let count = frames.len().max(1) as f64;
        let degrees = |f: &FrameError| f.rotation_deg.unwrap_or(180.0);
        let share =
            |right: &dyn Fn(&FrameError) -> bool| frames.iter().filter(|f| right(f)).count() as f64 / count;
        let times: Vec<f64> = frames.iter().filter_map(|f| f.seconds).collect();
        Self {
            angular_error_deg: frames.iter().map(degrees).sum::<f64>() / count,
            acc15: share(&|f| degrees(f) < 15.0),
            acc30: share(&|f| degrees(f) < 30.0),
            within_5deg_5cm: share(&|f| degrees(f) < 5.0 && f.translation.is_some_and(|t| t < 0.05)),
            mean_time_per_pair_s: match times.len() {
                0 => -1.0,
                n => times.iter().sum::<f64>() / n as f64,
            },
            without_pose: frames.len() - times.len(),
            method,
            frames,
        }
    }
}

fn mean(points: &[[f32; 3]]) -> Vector3<f64> {
    let sum = points.iter().fold(Vector3::zeros(), |sum, p| sum + Vector3::from(p.map(f64::from)));
    sum / points.len().max(1) as f64
}

/// The table of all methods, as Markdown.
pub fn sequence_table(name: &str, reference: u32, runs: &[SequenceRun]) -> String {
    let frames = runs.first().map_or(0, |run| run.frames.len());
    let columns =
        ["method", "angular error", "Acc15", "Acc30", "5 deg 5 cm", "s per pair", "frames without a pose"];
    let row = |run: &SequenceRun| {
        vec![
            run.method.clone(),
            format!("{:.1}", run.angular_error_deg),
            percent(run.acc15),
            percent(run.acc30),
            percent(run.within_5deg_5cm),
            seconds(run.mean_time_per_pair_s),
            run.without_pose.to_string(),
        ]
    };
    let heading = format!("{name} ({frames} frames, reference {reference})");
    Section::markdown(&heading, [Section::table(columns, runs.iter().map(row))])
}
