//! The comparison as one HTML page.

use std::fmt::Write as _;

use unopose_eval::metrics::Interval;

use super::{
    comparison::Comparison,
    comparison_sections::{by_rotation, differences, methods, other_metrics, published, title},
    examples::Examples,
    published::published_rows,
    section::{Section, escaped, html_row},
    unoseg_masks,
};

const STYLE: &str = "body{font:15px sans-serif;max-width:72em;margin:2em auto}table{border-collapse:collapse}\
td,th{white-space:nowrap;padding:.25em .7em;text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}\
.bar{position:relative;background:#eee;width:22em;height:1.1em}.bar div{position:absolute;height:100%}\
.ar{background:#4a7fb5}.range{background:#0007;height:3px!important;top:45%}img{max-width:100%}";

/// Heads of the first table: those of [`methods`], shorter, with the bars.
const METHOD_COLUMNS: [&str; 9] =
    ["method", "", "AR", "95 %", "VSD", "MSSD", "MSPD", "s per pair", "no pose"];

/// Table, bars with intervals, recall curves, and the worst and best cases of every method.
pub(crate) fn html(comparison: &Comparison, examples: &[Examples]) -> String {
    let title = escaped(&title(comparison));
    let mut page = format!(
        "<!doctype html><html><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style></head>\
         <body><h1>{title}</h1>\n{}",
        methods_with_bars(comparison)
    );
    page += &heading("Differences on the same targets");
    page += &Section { columns: Vec::new(), ..differences(comparison) }.html();
    page += &heading("Recall");
    page += "<img src=\"recall.svg\" alt=\"recall by threshold\">\n";
    let own = &comparison.facts.unoseg_masks;
    if !own.is_empty() {
        page += &(heading("Our own segmentation") + &unoseg_masks::section(own).html());
    }
    page += &(heading("Other metrics") + &other_metrics(comparison).html());
    if let Some(table) = by_rotation(comparison) {
        page += &heading("By the angle to the reference");
        page += "<img src=\"rotation.svg\" alt=\"recall by angle\">\n";
        page += &table.html();
    }
    for table in published(comparison) {
        page += &(heading(&table.title) + &table.html());
    }
    let skipped = &comparison.skipped_detections;
    if !skipped.is_empty() {
        let rows = skipped.iter().map(|(reason, count)| vec![reason.clone(), count.to_string()]);
        page += &heading("Detections skipped for bad input");
        page += &Section::table(["reason", "detections"], rows).html();
    }
    for example in examples {
        let (name, worst, best) = (escaped(&example.method), &example.worst, &example.best);
        let _ = writeln!(
            page,
            "<h2>{name}: the worst and the best cases</h2>\n<p>Reference points in the estimated pose, worst first: {}</p>\
             <img src=\"{}\" alt=\"worst cases of {name}\"><p>Best: {}</p><img src=\"{}\" alt=\"best cases of {name}\">",
            escaped(&worst.caption),
            worst.file,
            escaped(&best.caption),
            best.file,
        );
    }
    page + "</body></html>\n"
}

/// The methods with bars of their average recalls, and the paper's methods below them.
fn methods_with_bars(comparison: &Comparison) -> String {
    let mut rows = html_row("th", METHOD_COLUMNS.map(str::to_owned));
    for (cells, method) in methods(comparison).rows.iter().zip(&comparison.methods) {
        let mut cells: Vec<String> = cells.iter().map(|cell| escaped(cell)).collect();
        cells.insert(1, bar(method.scores.recall.ar, &method.ar));
        rows += &html_row("td", cells);
    }
    for row in published_rows(&comparison.dataset, &comparison.facts.list) {
        let name = format!("{} ({}, published)", row.method, row.segmentation);
        let bar = format!(
            "<div class=\"bar\"><div class=\"ar\" style=\"width:{:.1}%;opacity:.4\"></div></div>",
            row.ar
        );
        rows += &html_row("td", [escaped(&name), bar, format!("{:.1}", row.ar)]);
    }
    format!("<table>{rows}</table>\n")
}

/// A share as a bar with its interval.
fn bar(share: f64, interval: &Interval) -> String {
    format!(
        "<div class=\"bar\"><div class=\"ar\" style=\"width:{:.1}%\"></div>\
         <div class=\"range\" style=\"left:{:.1}%;width:{:.1}%\"></div></div>",
        100.0 * share,
        100.0 * interval.low,
        100.0 * (interval.high - interval.low)
    )
}

fn heading(text: &str) -> String {
    format!("<h2>{}</h2>\n", escaped(text))
}
