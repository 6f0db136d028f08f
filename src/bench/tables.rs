//! The comparison as Markdown, CSV and JSON.

use std::{fmt::Write as _, io::Write as _, path::Path};

use super::{BenchError, Comparison, MethodScore, examples::Examples, page, published::published_rows};
use crate::{
    eval::Interval,
    formats::{FormatError, files::write_json, write_atomic},
    report::{Curve, Panel, write_curves},
};

/// Writes `table.md`, `table.csv`, `table.json`, `recall.svg` and `index.html` into a folder.
pub fn write_report(comparison: &Comparison, examples: &[Examples], folder: &Path) -> Result<(), BenchError> {
    write_json(&folder.join("table.json"), comparison, true)?;
    let text =
        |name: &str, text: &str| write_atomic(&folder.join(name), |out| out.write_all(text.as_bytes()));
    text("table.md", &markdown(comparison))?;
    write_csv(comparison, &folder.join("table.csv"))?;
    write_curves(
        &folder.join("recall.svg"),
        "threshold, share of the diameter (MSSD)",
        &[recall(comparison)],
    )?;
    text("index.html", &page::html(comparison, examples))?;
    Ok(())
}

/// The table with the paper's numbers below ours where it has them.
pub fn markdown(comparison: &Comparison) -> String {
    let mut text = format!("# {} ({} targets)\n\n", comparison.dataset, comparison.targets);
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
    let published = published_rows(&comparison.dataset);
    if !published.is_empty() {
        text += "\n| published (Table 2) | segmentation | AR | s per image |\n|--|--|--|--|\n";
        for row in published {
            let _ = writeln!(
                text,
                "| {} | {} | {:.1} | {:.2} |",
                row.method, row.segmentation, row.ar, row.seconds
            );
        }
    }
    let _ = writeln!(
        text,
        "\nIntervals: {} resamples of the images, seed {}. Targets without a pose count as missed.",
        comparison.resamples, comparison.seed
    );
    for method in comparison.methods.iter().filter(|m| !m.rejections.is_empty()) {
        let _ = writeln!(text, "\nWithout a pose in {}:\n", method.name);
        method.rejections.iter().for_each(|(reason, count)| {
            let _ = writeln!(text, "* {count} x {reason}");
        });
    }
    text
}

fn write_csv(comparison: &Comparison, path: &Path) -> Result<(), FormatError> {
    write_atomic(path, |out| {
        let header =
            "method,ar,ar_low,ar_high,ar_vsd,ar_mssd,ar_mspd,targets,without_pose,pairs,seconds_per_pair";
        writeln!(out, "{header}")?;
        for MethodScore { name, ar, scores, targets_without_pose, pairs, mean_time_per_pair_s, .. } in
            &comparison.methods
        {
            let r = &scores.recall;
            writeln!(
                out,
                "{name},{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{},{targets_without_pose},{pairs},{mean_time_per_pair_s:.4}",
                r.ar, ar.low, ar.high, r.ar_vsd, r.ar_mssd, r.ar_mspd, r.n_targets
            )?;
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

pub(super) fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

pub(super) fn span(interval: &Interval) -> String {
    format!("{} .. {}", percent(interval.low), percent(interval.high))
}

pub(super) fn seconds(seconds: f64) -> String {
    if seconds >= 0.0 { format!("{seconds:.3}") } else { "unknown".into() }
}
