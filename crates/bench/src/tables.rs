//! The comparison as Markdown, CSV and JSON.

use std::{fmt::Write as _, io::Write as _, path::Path};

use unopose_core::files::{FileError, write_atomic};
use unopose_dataset::formats::files::write_json;
use unopose_eval::{
    eval::Interval,
    report::{Curve, Panel, write_curves},
};

use super::{
    BenchError, Comparison, MethodScore, OverlapBin, examples::Examples, own_masks, page,
    published::published_tables,
};

/// Writes `table.md`, `table.csv`, `table.json`, `recall.svg` and `index.html` into a folder, and `segmentation.csv` where the
/// masks are our own.
pub fn write_report(comparison: &Comparison, examples: &[Examples], folder: &Path) -> Result<(), BenchError> {
    write_json(&folder.join("table.json"), comparison, true)?;
    let text =
        |name: &str, text: &str| write_atomic(&folder.join(name), |out| out.write_all(text.as_bytes()));
    text("table.md", &markdown(comparison))?;
    write_csv(comparison, &folder.join("table.csv"))?;
    let own = &comparison.facts.own_masks;
    if !own.is_empty() {
        own_masks::write_csv(own, &folder.join("segmentation.csv"))?;
    }
    write_curves(
        &folder.join("recall.svg"),
        "threshold, share of the diameter (MSSD)",
        &[recall(comparison)],
    )?;
    if comparison.overlaps.len() > 1 {
        write_curves(&folder.join("rotation.svg"), "degrees to the reference", &[rotation(comparison)])?;
    }
    text("index.html", &page::html(comparison, examples))?;
    Ok(())
}

/// The table with the paper's numbers below ours where it has them.
pub fn markdown(comparison: &Comparison) -> String {
    let facts = &comparison.facts;
    let mut text = format!("# {}\n\n", title(comparison));
    text += "| method | AR | 95 % interval | VSD | MSSD | MSPD | s per pair | targets without a pose |\n";
    text += "|--|--|--|--|--|--|--|--|\n";
    for method in &comparison.methods {
        let r = &method.scores.recall;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} |",
            method.name,
            percent(r.ar),
            span(&method.ar),
            percent(r.ar_vsd),
            percent(r.ar_mssd),
            percent(r.ar_mspd),
            seconds(method.mean_time_per_pair_s),
            method.targets_without_pose
        );
    }
    if !comparison.differences.is_empty() {
        text += "\n| difference of AR, same targets | points | 95 % interval |\n|--|--|--|\n";
        for difference in &comparison.differences {
            let (a, b, ar) = (&difference.a, &difference.b, &difference.ar);
            let _ = writeln!(text, "| {a} - {b} | {} | {} |", percent(ar.value), span(ar));
        }
    }
    if !facts.own_masks.is_empty() {
        let _ = writeln!(
            text,
            "\nOur own segmentation:\n\n| {} |\n{}|",
            own_masks::COLUMNS.join(" | "),
            "|--".repeat(own_masks::COLUMNS.len())
        );
        facts.own_masks.iter().for_each(|masks| {
            let _ = writeln!(text, "| {} |", masks.cells().join(" | "));
        });
    }
    text += "\n| method | mAP | AUC of ADD | AUC of ADD-S | ADD(-S) 10 % | angular error | Acc15 | Acc30 |\n";
    text += "|--|--|--|--|--|--|--|--|\n";
    for method in &comparison.methods {
        let _ = writeln!(text, "| {} | {} |", method.name, other_metrics(method).join(" | "));
    }
    if comparison.overlaps.len() > 1 {
        let names: Vec<&str> = comparison.methods.iter().map(|m| m.name.as_str()).collect();
        let _ = writeln!(
            text,
            "\nAR by the angle to the reference:\n\n| degrees | targets | overlap | {} |",
            names.join(" | ")
        );
        let _ = writeln!(text, "{}|", "|--".repeat(3 + names.len()));
        for row in rotation_rows(comparison) {
            let _ = writeln!(text, "| {} |", row.join(" | "));
        }
    }
    for table in published_tables(&comparison.dataset, &facts.list) {
        let _ = writeln!(text, "\nPublished: {}\n\n| {} |", table.title, table.columns.join(" | "));
        let _ = writeln!(text, "{}|", "|--".repeat(table.columns.len()));
        table.rows.iter().for_each(|row| {
            let _ = writeln!(text, "| {} |", row.join(" | "));
        });
    }
    let _ = writeln!(
        text,
        "\nIntervals: {} resamples of the images, seed {}. Targets without a pose count as missed.",
        comparison.resamples, comparison.seed
    );
    if let Some(map) = facts.mask_map {
        let _ = writeln!(text, "\nmAP of the masks: {}.", percent(map));
    }
    if let Some(seed) = facts.list_seed {
        let _ = writeln!(text, "\nReferences drawn with seed {seed}.");
    }
    if facts.without_reference > 0 {
        let count = facts.without_reference;
        let _ = writeln!(text, "\n{count} targets have no such reference and are not in the list.");
    }
    if !comparison.skipped_detections.is_empty() {
        text += "\nDetections skipped for bad input:\n\n";
        comparison.skipped_detections.iter().for_each(|(reason, count)| {
            let _ = writeln!(text, "* {count} x {reason}");
        });
    }
    for method in comparison.methods.iter().filter(|m| !m.rejections.is_empty()) {
        let _ = writeln!(text, "\nWithout a pose in {}:\n", method.name);
        method.rejections.iter().for_each(|(reason, count)| {
            let _ = writeln!(text, "* {count} x {reason}");
        });
    }
    text
}

/// Dataset, list and masks.
pub(super) fn title(comparison: &Comparison) -> String {
    let facts = &comparison.facts;
    format!(
        "{}, {}, {} masks ({} targets)",
        comparison.dataset, facts.list, facts.segmentation, comparison.targets
    )
}

/// mAP, areas under ADD and ADD-S, ADD(-S) within 10 % of the diameter, angular error, accuracies at 15 and 30 degrees.
pub(super) fn other_metrics(method: &MethodScore) -> [String; 7] {
    let (map, accuracy) = (&method.scores.detection, &method.scores.accuracy);
    [
        percent(map.map),
        percent(accuracy.add_auc),
        percent(accuracy.add_s_auc),
        percent(accuracy.add_or_add_s_01d),
        format!("{:.1}", accuracy.angular_error_deg),
        percent(accuracy.acc15),
        percent(accuracy.acc30),
    ]
}

/// Angle, targets, overlap, and the average recall of every method.
pub(super) fn rotation_rows(comparison: &Comparison) -> Vec<Vec<String>> {
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
    comparison.overlaps.iter().map(row).collect()
}

fn write_csv(comparison: &Comparison, path: &Path) -> Result<(), FileError> {
    write_atomic(path, |out| {
        let header = "method,ar,ar_low,ar_high,ar_vsd,ar_mssd,ar_mspd,targets,without_pose,pairs,seconds_per_pair,map,add_auc,\
             add_s_auc,add_or_add_s_01d,angular_error_deg,acc15,acc30";
        writeln!(out, "{header}")?;
        for MethodScore { name, ar, scores, targets_without_pose, pairs, mean_time_per_pair_s, .. } in
            &comparison.methods
        {
            let (r, map, a) = (&scores.recall, &scores.detection, &scores.accuracy);
            write!(
                out,
                "{name},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{},{targets_without_pose},{pairs},{mean_time_per_pair_s:.4}",
                r.ar, ar.low, ar.high, r.ar_vsd, r.ar_mssd, r.ar_mspd, r.n_targets
            )?;
            let others =
                [map.map, a.add_auc, a.add_s_auc, a.add_or_add_s_01d, a.angular_error_deg, a.acc15, a.acc30];
            others.iter().try_for_each(|value| write!(out, ",{value:.6}"))?;
            writeln!(out)?;
        }
        Ok(())
    })
}

fn recall(comparison: &Comparison) -> Panel {
    let curve = |method: &MethodScore| Curve {
        label: method.name.clone(),
        points: (1..).map(|i| 0.05 * f64::from(i)).zip(method.scores.recall_mssd).collect(),
        faint: false,
    };
    let curves = comparison.methods.iter().map(curve).collect();
    Panel { title: "Recall".into(), curves, range: Some((0.0, 1.0)) }
}

/// Average recall and overlap by the angle to the reference.
fn rotation(comparison: &Comparison) -> Panel {
    let middle = |from: f64, to: f64| 0.5 * (from + to);
    let of_method = |method: &MethodScore| Curve {
        label: method.name.clone(),
        points: method.scores.per_rotation.iter().map(|b| (middle(b.from, b.to), b.recall.ar)).collect(),
        faint: false,
    };
    let overlaps = comparison.overlaps.iter().filter_map(|b| Some((middle(b.from, b.to), b.overlap?[0])));
    let overlap = Curve { label: "overlap".into(), points: overlaps.collect(), faint: true };
    let curves = comparison.methods.iter().map(of_method).chain([overlap]).collect();
    Panel { title: "Average recall".into(), curves, range: Some((0.0, 1.0)) }
}

pub(super) fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

pub(super) fn span(interval: &Interval) -> String {
    format!("{} .. {}", percent(interval.low), percent(interval.high))
}

pub(super) fn seconds(seconds: f64) -> String {
    if seconds >= 0.0 { format!("{seconds:.3}") } else { "unknown".into() }
}
