//! A comparison as the sections of its report.

use super::{
    cells::{percent, seconds, span},
    comparison::{Comparison, MethodScore},
    facts::OverlapBin,
    published::published_tables,
    section::Section,
    unoseg_masks,
};

/// The tables with the paper's numbers below ours where it has them, and what has to be known about them.
pub(crate) fn markdown(comparison: &Comparison) -> String {
    let differences = Some(differences(comparison)).filter(|table| !table.rows.is_empty());
    let unoseg_masks = Some(&comparison.facts.unoseg_masks).filter(|masks| !masks.is_empty());
    let sections = std::iter::once(methods(comparison))
        .chain(differences)
        .chain(unoseg_masks.map(|masks| unoseg_masks::section(masks).titled("Our own segmentation:")))
        .chain([other_metrics(comparison)])
        .chain(by_rotation(comparison).map(|table| table.titled("AR by the angle to the reference:")))
        .chain(published(comparison))
        .chain([Section::notes(remarks(comparison))])
        .chain(reasons(comparison));
    Section::markdown(&title(comparison), sections)
}

/// Dataset, list and masks.
pub(crate) fn title(comparison: &Comparison) -> String {
    let facts = &comparison.facts;
    format!(
        "{}, {}, {} masks ({} targets)",
        comparison.dataset, facts.list, facts.segmentation, comparison.targets
    )
}

/// Average recalls and times, one method per row.
pub(crate) fn methods(comparison: &Comparison) -> Section {
    let columns =
        ["method", "AR", "95 % interval", "VSD", "MSSD", "MSPD", "s per pair", "targets without a pose"];
    let row = |method: &MethodScore| {
        let r = &method.scores.recall;
        vec![
            method.name.clone(),
            percent(r.ar),
            span(&method.ar),
            percent(r.ar_vsd),
            percent(r.ar_mssd),
            percent(r.ar_mspd),
            seconds(method.mean_time_per_pair_s),
            method.targets_without_pose.to_string(),
        ]
    };
    Section::table(columns, comparison.methods.iter().map(row))
}

/// Methods against the best one; no rows for a single method.
pub(crate) fn differences(comparison: &Comparison) -> Section {
    let rows = comparison.differences.iter().map(|difference| {
        let name = format!("{} - {}", difference.a, difference.b);
        vec![name, percent(difference.ar.value), span(&difference.ar)]
    });
    Section::table(["difference of AR, same targets", "points", "95 % interval"], rows)
}

/// mAP, areas under ADD and ADD-S, ADD(-S) within 10 % of the diameter, angular error, accuracies at 15 and 30 degrees.
pub(crate) fn other_metrics(comparison: &Comparison) -> Section {
    let columns =
        ["method", "mAP", "AUC of ADD", "AUC of ADD-S", "ADD(-S) 10 %", "angular error", "Acc15", "Acc30"];
    let row = |method: &MethodScore| {
        let accuracy = &method.scores.accuracy;
        vec![
            method.name.clone(),
            percent(method.scores.detection.map),
            percent(accuracy.add_auc),
            percent(accuracy.add_s_auc),
            percent(accuracy.add_or_add_s_01d),
            format!("{:.1}", accuracy.angular_error_deg),
            percent(accuracy.acc15),
            percent(accuracy.acc30),
        ]
    };
    Section::table(columns, comparison.methods.iter().map(row))
}

/// Angle, targets, overlap, and the average recall of every method; `None` when all angles are in one bin.
pub(crate) fn by_rotation(comparison: &Comparison) -> Option<Section> {
    if comparison.overlaps.len() <= 1 {
        return None;
    }
    let names = comparison.methods.iter().map(|m| m.name.as_str());
    let row = |bin: &OverlapBin| {
        let overlap = bin.overlap.map_or("unknown".into(), |[mean, deviation]| {
            format!("{} +- {}", percent(mean), percent(deviation))
        });
        let recall = |method: &MethodScore| {
            let found = method.scores.per_rotation.iter().find(|b| b.from == bin.from);
            found.map_or("-".into(), |b| percent(b.recall.ar))
        };
        let head = [format!("{:.0}-{:.0}", bin.from, bin.to), bin.targets.to_string(), overlap];
        head.into_iter().chain(comparison.methods.iter().map(recall)).collect()
    };
    let columns = ["degrees", "targets", "overlap"].into_iter().chain(names);
    Some(Section::table(columns, comparison.overlaps.iter().map(row)))
}

/// The paper's tables for the dataset and the list.
pub(crate) fn published(comparison: &Comparison) -> impl Iterator<Item = Section> {
    let tables = published_tables(&comparison.dataset, &comparison.facts.list).into_iter();
    tables.map(|table| {
        let title = format!("Published: {}", table.title);
        Section::table(table.columns.iter().copied(), table.rows).titled(title)
    })
}

/// How the numbers came about.
fn remarks(comparison: &Comparison) -> Vec<String> {
    let facts = &comparison.facts;
    let intervals = format!(
        "Intervals: {} resamples of the images, seed {}. Targets without a pose count as missed.",
        comparison.resamples, comparison.seed
    );
    let map = facts.mask_map.map(|map| format!("mAP of the masks: {}.", percent(map)));
    let seed = facts.list_seed.map(|seed| format!("References drawn with seed {seed}."));
    let absent = (facts.without_reference > 0).then(|| {
        format!("{} targets have no such reference and are not in the list.", facts.without_reference)
    });
    std::iter::once(intervals).chain(map).chain(seed).chain(absent).collect()
}

/// Why detections were skipped, and why targets have no pose, as lists.
fn reasons(comparison: &Comparison) -> impl Iterator<Item = Section> {
    let list = |(title, counts): (String, &[(String, usize)])| {
        let lines = counts.iter().map(|(reason, count)| format!("* {count} x {reason}"));
        Section::notes(vec![lines.collect::<Vec<_>>().join("\n")]).titled(title)
    };
    let skipped = ("Detections skipped for bad input:".to_owned(), &comparison.skipped_detections[..]);
    let rejected = comparison
        .methods
        .iter()
        .map(|method| (format!("Without a pose in {}:", method.name), &method.rejections[..]));
    std::iter::once(skipped).chain(rejected).filter(|(_, counts)| !counts.is_empty()).map(list)
}

/// All scores of the methods, unrounded.
pub(crate) fn methods_csv(comparison: &Comparison) -> Section {
    let columns = [
        "method",
        "ar",
        "ar_low",
        "ar_high",
        "ar_vsd",
        "ar_mssd",
        "ar_mspd",
        "targets",
        "without_pose",
        "pairs",
        "seconds_per_pair",
        "map",
        "add_auc",
        "add_s_auc",
        "add_or_add_s_01d",
        "angular_error_deg",
        "acc15",
        "acc30",
    ];
    let number = |value: f64| format!("{value:.6}");
    let row = |method: &MethodScore| {
        let MethodScore { name, ar, scores, targets_without_pose, pairs, mean_time_per_pair_s, .. } = method;
        let (r, map, a) = (&scores.recall, &scores.detection, &scores.accuracy);
        let counts = [r.n_targets, *targets_without_pose, *pairs].map(|count| count.to_string());
        let others =
            [map.map, a.add_auc, a.add_s_auc, a.add_or_add_s_01d, a.angular_error_deg, a.acc15, a.acc30];
        std::iter::once(name.clone())
            .chain([r.ar, ar.low, ar.high, r.ar_vsd, r.ar_mssd, r.ar_mspd].map(number))
            .chain(counts)
            .chain([format!("{mean_time_per_pair_s:.4}")])
            .chain(others.map(number))
            .collect()
    };
    Section::table(columns, comparison.methods.iter().map(row))
}
