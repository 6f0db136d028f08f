//! Analysed pairs as tables.

use std::{io::Write as _, path::Path};

use unopose_core::files::write_atomic;
use unopose_dataset::formats::files::write_json;
use unopose_eval::metrics::{ROTATION_EDGES, VISIBILITY_EDGES};

use super::{
    AnalysisError, PairRecord,
    record::{PrecisionRecall, StageMeasures},
};
use crate::{cells, section::Section};

/// Largest rotation error of a pose that is found, degrees.
const FOUND_DEG: f64 = 15.0;

/// A group of pairs with a name.
struct Group<'a> {
    name: String,
    pairs: Vec<&'a PairRecord>,
}

/// A column: its head, and its text for a group.
type Column = (&'static str, fn(&[&PairRecord]) -> String);

const MATCHING: [Column; 8] = [
    ("coarse inliers", |p| percent(mean(p, |r| r.stages.coarse_inliers))),
    ("drawn inliers", |p| percent(mean(p, |r| r.stages.drawn_inliers))),
    ("fine distance", |p| number(mean(p, |r| r.stages.fine_distance), 3)),
    ("fine inliers", |p| percent(mean(p, |r| r.stages.fine_inliers))),
    ("overlap P (q)", |p| percent(overlap(p, |s| s.overlap_query, |o| o.precision))),
    ("R (q)", |p| percent(overlap(p, |s| s.overlap_query, |o| o.recall))),
    ("overlap P (r)", |p| percent(overlap(p, |s| s.overlap_reference, |o| o.precision))),
    ("R (r)", |p| percent(overlap(p, |s| s.overlap_reference, |o| o.recall))),
];

const POSES: [Column; 9] = [
    ("best hypothesis", |p| percent(found(p, |s| s.best_hypothesis_deg))),
    ("best kept", |p| percent(found(p, |s| s.best_kept_deg))),
    ("coarse", |p| percent(found(p, |s| Some(s.coarse.rotation_deg)))),
    ("fine", |p| percent(found(p, |s| Some(s.fine.rotation_deg)))),
    ("fine from truth", |p| percent(found(p, |s| Some(s.fine_from_truth?.rotation_deg)))),
    ("median fine", |p| number(median(p, |s| Some(s.fine.rotation_deg)), 1)),
    ("median from truth", |p| number(median(p, |s| Some(s.fine_from_truth?.rotation_deg)), 1)),
    ("AR", |p| percent(mean(p, |r| Some(r.credit)))),
    ("AR refined", |p| percent(mean(p, |r| Some(r.refined_credit)))),
];

const LOCAL_FRAMES: [Column; 4] = [
    ("small ball", |p| number(median(p, |s| Some(s.local_frames[0]?.frame_deg)), 1)),
    ("its z axis", |p| number(median(p, |s| Some(s.local_frames[0]?.normal_deg)), 1)),
    ("large ball", |p| number(median(p, |s| Some(s.local_frames[1]?.frame_deg)), 1)),
    ("its z axis", |p| number(median(p, |s| Some(s.local_frames[1]?.normal_deg)), 1)),
];

/// Writes `pairs.json` and `findings.md` into a folder and returns the text of the latter.
pub fn write_findings(records: &[PairRecord], title: &str, folder: &Path) -> Result<String, AnalysisError> {
    let groups = groups(records);
    let refined = records.iter().any(|r| r.stages.refined_truth.is_some());
    let poses = format!("{} pairs. Rotations found within {FOUND_DEG} degrees, in percent:", records.len());
    let matching = "Matches and overlaps, in percent; distances in radii of the reference:";
    let frames =
        "Local frames of the same places in both views, median angle of the pairs' median angles, degrees:";
    let tables = [
        table(&groups, &POSES).titled(poses),
        table(&groups, &MATCHING).titled(matching),
        table(&groups, &LOCAL_FRAMES).titled(frames),
    ];
    let refinement =
        refined.then(|| refinement(records).titled("Refinement by the rotation error of its start:"));
    let text = Section::markdown(title, tables.into_iter().chain(refinement));
    write_json(&folder.join("pairs.json"), records, false)?;
    write_atomic(&folder.join("findings.md"), |file| file.write_all(text.as_bytes()))?;
    Ok(text)
}

fn groups(records: &[PairRecord]) -> Vec<Group<'_>> {
    let mut groups = vec![Group { name: "all".into(), pairs: records.iter().collect() }];
    let mut add = |name: String, inside: &dyn Fn(&PairRecord) -> bool| {
        let pairs: Vec<&PairRecord> = records.iter().filter(|r| inside(r)).collect();
        if !pairs.is_empty() {
            groups.push(Group { name, pairs });
        }
    };
    for limits in VISIBILITY_EDGES.windows(2) {
        let last = limits[1] >= 1.0;
        add(format!("visible {:.1}-{:.1}", limits[0], limits[1]), &|r| {
            r.visib_fract >= limits[0] && (r.visib_fract < limits[1] || last)
        });
    }
    for limits in ROTATION_EDGES.windows(2) {
        let last = limits[1] >= 180.0;
        add(format!("{:.0}-{:.0} degrees", limits[0], limits[1]), &|r| {
            r.rot_deg >= limits[0] && (r.rot_deg < limits[1] || last)
        });
    }
    thirds(records, "diameter", " m", 3, |r| r.diameter, &mut add);
    thirds(records, "texture", "", 1, |r| r.texture, &mut add);
    thirds(records, "pixels", "", 0, |r| r.evidence.points as f64, &mut add);
    groups
}

/// Three groups of about equal counts.
fn thirds(
    records: &[PairRecord],
    name: &str,
    unit: &str,
    digits: usize,
    of: fn(&PairRecord) -> f64,
    add: &mut impl FnMut(String, &dyn Fn(&PairRecord) -> bool),
) {
    let mut values: Vec<f64> = records.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    let limit = |third: usize| values.get(values.len() * third / 3).copied().unwrap_or(0.0);
    let (low, high) = (limit(1), limit(2));
    add(format!("{name} < {low:.digits$}{unit}"), &|r| of(r) < low);
    add(format!("{name} {low:.digits$}-{high:.digits$}{unit}"), &|r| (low..high).contains(&of(r)));
    add(format!("{name} >= {high:.digits$}{unit}"), &|r| of(r) >= high);
}

fn table(groups: &[Group<'_>], columns: &[Column]) -> Section {
    let rows = groups.iter().map(|Group { name, pairs }| {
        let cells = columns.iter().map(|column| (column.1)(pairs));
        [name.clone(), pairs.len().to_string()].into_iter().chain(cells).collect()
    });
    Section::table(["pairs", "n"].into_iter().chain(columns.iter().map(|column| column.0)), rows)
}

/// How refinement changes rotation errors, by where it starts; the last row starts from the truth.
fn refinement(records: &[PairRecord]) -> Section {
    let bins = [(0.0, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 15.0), (15.0, 180.1)];
    let row = |name: String, changes: Vec<(f64, f64)>| {
        let share = |hit: fn(&(f64, f64)) -> bool| {
            percent(Some(changes.iter().filter(|c| hit(c)).count() as f64 / changes.len().max(1) as f64))
        };
        let middle = |of: fn(&(f64, f64)) -> f64| number(middle(changes.iter().map(of).collect()), 2);
        vec![
            name,
            changes.len().to_string(),
            middle(|c| c.0),
            middle(|c| c.1),
            share(|c| c.1 > c.0 + 1.0),
            share(|c| c.1 < c.0 - 1.0),
        ]
    };
    let mut rows = Vec::new();
    for (from, to) in bins {
        let changes: Vec<(f64, f64)> = records
            .iter()
            .map(|r| (r.stages.fine.rotation_deg, r.stages.refined.rotation_deg))
            .filter(|c| c.0 >= from && c.0 < to)
            .collect();
        if !changes.is_empty() {
            rows.push(row(format!("{from:.0}-{to:.0} degrees"), changes));
        }
    }
    let from_truth = records.iter().filter_map(|r| Some((0.0, r.stages.refined_truth?.rotation_deg)));
    rows.push(row("the truth".into(), from_truth.collect()));
    let columns =
        ["start", "n", "median before", "median after", "worse by over 1 degree", "better by over 1 degree"];
    Section::table(columns, rows)
}

fn mean(pairs: &[&PairRecord], of: fn(&PairRecord) -> Option<f64>) -> Option<f64> {
    let values: Vec<f64> = pairs.iter().filter_map(|r| of(r)).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn overlap(
    pairs: &[&PairRecord],
    side: fn(&StageMeasures) -> PrecisionRecall,
    of: fn(PrecisionRecall) -> Option<f64>,
) -> Option<f64> {
    let values: Vec<f64> = pairs.iter().filter_map(|r| of(side(&r.stages))).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Share of the pairs whose rotation error is small; a pair without one counts as not found.
fn found(pairs: &[&PairRecord], of: fn(&StageMeasures) -> Option<f64>) -> Option<f64> {
    let found = pairs.iter().filter(|r| of(&r.stages).is_some_and(|degrees| degrees < FOUND_DEG)).count();
    (!pairs.is_empty()).then(|| found as f64 / pairs.len() as f64)
}

fn median(pairs: &[&PairRecord], of: fn(&StageMeasures) -> Option<f64>) -> Option<f64> {
    middle(pairs.iter().filter_map(|r| of(&r.stages)).collect())
}

fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".into(), cells::percent)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"))
}
