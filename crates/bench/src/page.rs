//! The comparison as one HTML page.

use std::fmt::Write as _;

use super::{
    Comparison,
    examples::Examples,
    own_masks,
    published::{published_rows, published_tables},
    tables,
};

const STYLE: &str = "body{font:15px sans-serif;max-width:72em;margin:2em auto}table{border-collapse:collapse}\
td,th{white-space:nowrap;padding:.25em .7em;text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}\
.bar{position:relative;background:#eee;width:22em;height:1.1em}.bar div{position:absolute;height:100%}\
.ar{background:#4a7fb5}.range{background:#0007;height:3px!important;top:45%}img{max-width:100%}";

/// Table, bars with intervals, recall curves, and the worst and best cases of every method.
pub fn html(comparison: &Comparison, examples: &[Examples]) -> String {
    let title = escaped(&tables::title(comparison));
    let mut page = format!(
        "<!doctype html><html><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style></head>\
         <body><h1>{title}</h1>\n<table><tr><th>method</th><th></th><th>AR</th><th>95 %</th><th>VSD</th><th>MSSD</th>\
         <th>MSPD</th><th>s per pair</th><th>no pose</th></tr>\n"
    );
    for method in &comparison.methods {
        let (r, ar) = (&method.scores.recall, &method.ar);
        let _ = writeln!(
            page,
            "<tr><td>{}</td><td><div class=\"bar\"><div class=\"ar\" style=\"width:{:.1}%\"></div>\
             <div class=\"range\" style=\"left:{:.1}%;width:{:.1}%\"></div></div></td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escaped(&method.name),
            100.0 * r.ar,
            100.0 * ar.low,
            100.0 * (ar.high - ar.low),
            tables::percent(r.ar),
            tables::span(ar),
            tables::percent(r.ar_vsd),
            tables::percent(r.ar_mssd),
            tables::percent(r.ar_mspd),
            tables::seconds(method.mean_time_per_pair_s),
            method.targets_without_pose
        );
    }
    for row in published_rows(&comparison.dataset, &comparison.facts.list) {
        let _ = writeln!(
            page,
            "<tr><td>{} ({}, published)</td><td><div class=\"bar\"><div class=\"ar\" style=\"width:{:.1}%;opacity:.4\">\
             </div></div></td><td>{:.1}</td></tr>",
            row.method, row.segmentation, row.ar, row.ar
        );
    }
    page += "</table>\n<h2>Differences on the same targets</h2><table>\n";
    for difference in &comparison.differences {
        let _ = writeln!(
            page,
            "<tr><td>{} - {}</td><td>{}</td><td>{}</td></tr>",
            escaped(&difference.a),
            escaped(&difference.b),
            tables::percent(difference.ar.value),
            tables::span(&difference.ar)
        );
    }
    page += "</table>\n<h2>Recall</h2><img src=\"recall.svg\" alt=\"recall by threshold\">\n";
    let own = &comparison.facts.own_masks;
    if !own.is_empty() {
        page += "<h2>Our own segmentation</h2>\n";
        page += &table(&own_masks::COLUMNS, own.iter().map(|masks| masks.cells()));
    }
    page += "<h2>Other metrics</h2>\n";
    let others = comparison.methods.iter().map(|method| {
        std::iter::once(method.name.clone()).chain(tables::other_metrics(method)).collect::<Vec<_>>()
    });
    let columns =
        ["method", "mAP", "AUC of ADD", "AUC of ADD-S", "ADD(-S) 10 %", "angular error", "Acc15", "Acc30"];
    page += &table(&columns, others);
    if comparison.overlaps.len() > 1 {
        page += "<h2>By the angle to the reference</h2><img src=\"rotation.svg\" alt=\"recall by angle\">\n";
        let names = comparison.methods.iter().map(|m| m.name.as_str());
        let columns: Vec<&str> = ["degrees", "targets", "overlap"].into_iter().chain(names).collect();
        page += &table(&columns, tables::rotation_rows(comparison));
    }
    for published in published_tables(&comparison.dataset, &comparison.facts.list) {
        let _ = writeln!(page, "<h2>Published: {}</h2>", escaped(published.title));
        page += &table(published.columns, published.rows);
    }
    let skipped: usize = comparison.skipped_detections.iter().map(|(_, count)| count).sum();
    if skipped > 0 {
        page += "<h2>Detections skipped for bad input</h2>\n";
        let rows = comparison.skipped_detections.iter();
        page += &table(
            &["reason", "detections"],
            rows.map(|(reason, count)| vec![reason.clone(), count.to_string()]),
        );
    }
    for example in examples {
        let _ = writeln!(
            page,
            "<h2>{name}: the worst and the best cases</h2>\n<p>Reference points in the estimated pose, worst first: {}</p>\
             <img src=\"{}\" alt=\"worst cases of {name}\"><p>Best: {}</p><img src=\"{}\" alt=\"best cases of {name}\">",
            escaped(&example.worst.caption),
            example.worst.file,
            escaped(&example.best.caption),
            example.best.file,
            name = escaped(&example.method),
        );
    }
    page + "</body></html>\n"
}

fn table(columns: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let line = |cells: &mut dyn Iterator<Item = &str>, tag: &str| {
        let cells = cells.map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    let mut text = format!("<table>{}", line(&mut columns.iter().copied(), "th"));
    for row in rows {
        text += &line(&mut row.iter().map(String::as_str), "td");
    }
    text + "</table>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
