//! The comparison as one HTML page.

use std::fmt::Write as _;

use super::{Comparison, examples::Examples, published::published_rows, tables};

const STYLE: &str = "body{font:15px sans-serif;max-width:62em;margin:2em auto}table{border-collapse:collapse}\
td,th{padding:.25em .7em;text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}\
.bar{position:relative;background:#eee;width:22em;height:1.1em}.bar div{position:absolute;height:100%}\
.ar{background:#4a7fb5}.range{background:#0007;height:3px!important;top:45%}img{max-width:100%}";

/// Table, bars with intervals, recall curves, and the worst and best cases of every method.
pub fn html(comparison: &Comparison, examples: &[Examples]) -> String {
    let title = format!("{} ({} targets)", escaped(&comparison.dataset), comparison.targets);
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
    for row in published_rows(&comparison.dataset) {
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

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
