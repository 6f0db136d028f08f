//! The files of a comparison: tables, curves and the page.

use std::{io::Write as _, path::Path};

use unopose_core::files::write_atomic;
use unopose_dataset::formats::files::write_json;
use unopose_eval::report::{Curve, Panel, write_curves};

use super::{
    BenchError,
    comparison::{Comparison, MethodScore},
    comparison_sections::{markdown, methods_csv},
    examples::Examples,
    page, unoseg_masks,
};

/// Writes `table.md`, `table.csv`, `table.json`, `recall.svg` and `index.html` into a folder, and `segmentation.csv` where the
/// masks are our own.
pub(crate) fn write_report(
    comparison: &Comparison,
    examples: &[Examples],
    folder: &Path,
) -> Result<(), BenchError> {
    write_json(&folder.join("table.json"), comparison, true)?;
    let text =
        |name: &str, text: &str| write_atomic(&folder.join(name), |out| out.write_all(text.as_bytes()));
    text("table.md", &markdown(comparison))?;
    text("table.csv", &methods_csv(comparison).csv())?;
    let own = &comparison.facts.unoseg_masks;
    if !own.is_empty() {
        text("segmentation.csv", &unoseg_masks::csv(own).csv())?;
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
