//! The paper's numbers: AR_BOP in percent unless a column says otherwise.

use super::Switches;

/// A row of Table 2 ("Pose estimation results on LM-O, TUD-L, and YCB-V").
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PublishedRow {
    pub method: &'static str,
    pub segmentation: &'static str,
    /// AR in percent on the dataset asked for.
    pub ar: f64,
    /// Seconds per image, the mean over all three datasets.
    pub seconds: f64,
}

/// Method, segmentation, LM-O, TUD-L, YCB-V, seconds. The first two use the model, the others one reference image.
const TABLE: [(&str, &str, [f64; 3], f64); 15] = [
    ("ZTE-PPF (with model)", "MRCNN", [66.3, 90.4, 50.2], 0.74),
    ("Koenig-PPF (with model)", "Retina/MRCNN", [63.1, 92.0, 70.1], 0.99),
    ("Ref. AlignCenter", "UNOSeg-SAM", [27.3, 28.8, 47.5], 2.69),
    ("FPFH+RANSAC", "UNOSeg-SAM", [31.0, 31.0, 50.0], 6.38),
    ("FPFH+MAC", "UNOSeg-SAM", [22.5, 22.1, 49.6], 136.94),
    ("PPF", "UNOSeg-SAM", [29.7, 14.8, 38.3], 11.79),
    ("PPF_3D_ICP", "UNOSeg-SAM", [44.7, 29.1, 66.8], 14.27),
    ("FCGF+RANSAC", "UNOSeg-SAM", [38.9, 59.0, 57.6], 10.96),
    ("FCGF+MAC", "UNOSeg-SAM", [33.9, 48.3, 51.0], 60.53),
    ("UTOPIC", "UNOSeg-SAM", [13.7, 35.4, 10.5], 4.00),
    ("GeDi", "UNOSeg-SAM", [42.8, 67.3, 60.6], 48.89),
    ("FreeZe", "UNOSeg-SAM", [45.5, 68.3, 65.5], 52.96),
    ("SAM-6D (posed image)", "UNOSeg-SAM", [54.5, 29.7, 68.1], 4.21),
    ("UNOPose", "UNOSeg-FastSAM", [55.8, 66.5, 81.9], 1.11),
    ("UNOPose", "UNOSeg-SAM", [58.7, 71.0, 83.1], 3.70),
];

/// Lists that are the main experiment's: at most 50 degrees to the reference.
const MAIN_LISTS: [&str; 2] = ["rot50", "crossscene_rot50"];

/// Table 2 for a dataset, by the name of its folder (`lmo`, `tudl`, `ycbv`, dashes and case do not matter), and a list of
/// the main experiment; empty for any other.
pub(crate) fn published_rows(dataset: &str, list: &str) -> Vec<PublishedRow> {
    let name = plain(dataset);
    let column = ["lmo", "tudl", "ycbv"].iter().position(|known| name == *known);
    let (Some(column), true) = (column, MAIN_LISTS.contains(&list)) else { return Vec::new() };
    let row = |&(method, segmentation, ars, seconds): &(&'static str, &'static str, [f64; 3], f64)| {
        PublishedRow { method, segmentation, ar: ars[column], seconds }
    };
    TABLE.iter().map(row).collect()
}

/// A table of the paper.
#[derive(Clone, Debug)]
pub(crate) struct PublishedTable {
    pub title: &'static str,
    pub columns: &'static [&'static str],
    pub rows: Vec<Vec<String>>,
}

const SCORES: &[&str] = &["method", "VSD", "MSSD", "MSPD", "AR"];

/// What the paper has for a dataset and a list.
pub(crate) fn published_tables(dataset: &str, list: &str) -> Vec<PublishedTable> {
    let main = published_rows(dataset, list);
    let mut tables = Vec::new();
    if !main.is_empty() {
        let row = |r: PublishedRow| {
            let (ar, seconds) = (format!("{:.1}", r.ar), format!("{:.2}", r.seconds));
            vec![r.method.into(), r.segmentation.into(), ar, seconds]
        };
        tables.push(PublishedTable {
            title: "Table 2",
            columns: &["method", "segmentation", "AR", "s per image"],
            rows: main.into_iter().map(row).collect(),
        });
    }
    let name = plain(dataset);
    let mut add = |title, rows: &[(&str, [f64; 4])]| {
        let row = |(method, scores): &(&str, [f64; 4])| {
            std::iter::once((*method).to_owned()).chain(scores.map(|s| format!("{s:.1}"))).collect()
        };
        tables.push(PublishedTable { title, columns: SCORES, rows: rows.iter().map(row).collect() });
    };
    match (name.as_str(), list) {
        ("ycbv", "crossscene_rot50") => add("references from different scenes", &OTHER_SCENES),
        ("ycbv", "rendered") => add("rendered references (row E0)", &[("UNOPose", [83.7, 89.6, 83.1, 85.5])]),
        ("tudl", "one_per_object") => add("one reference per category", &ONE_REFERENCE),
        ("tudl", list) if list.ends_with("_per_object") => add("number of references", &REFERENCE_NUMBERS),
        ("ycbv", "rot50") => {
            add("ground-truth segmentation (row D3)", &[("UNOPose", [86.6, 89.2, 82.1, 86.0])])
        }
        ("lm", _) => tables.push(PublishedTable {
            title: "relative pose estimation on LM",
            columns: &["method", "modality", "angular error", "Acc30", "Acc15"],
            rows: ANGULAR.iter().map(|row| row.iter().map(|cell| (*cell).to_owned()).collect()).collect(),
        }),
        _ => {}
    }
    tables
}

const OTHER_SCENES: [(&str, [f64; 4]); 2] =
    [("Ref. AlignCenter", [31.7, 43.4, 19.5, 31.5]), ("UNOPose", [69.2, 74.8, 63.9, 69.3])];

const ONE_REFERENCE: [(&str, [f64; 4]); 4] = [
    ("UNOPose, dragon", [47.1, 73.2, 69.4, 63.2]),
    ("UNOPose, frog", [59.4, 52.6, 57.6, 56.4]),
    ("UNOPose, can", [56.8, 65.6, 65.2, 62.5]),
    ("UNOPose, mean", [54.4, 63.7, 64.1, 60.7]),
];

const REFERENCE_NUMBERS: [(&str, [f64; 4]); 7] = [
    ("UNOPose, 1 reference", [54.4, 63.7, 64.1, 60.7]),
    ("UNOPose, 8", [53.4, 65.9, 65.6, 61.6]),
    ("UNOPose, 12", [61.3, 74.2, 74.0, 69.8]),
    ("UNOPose, 16", [62.5, 74.3, 75.4, 70.7]),
    ("UNOPose, 32", [62.8, 76.2, 75.7, 71.6]),
    ("UNOPose, 42", [60.7, 75.0, 74.8, 70.0]),
    ("UNOPose, random", [61.9, 75.2, 75.9, 71.0]),
];

const ANGULAR: [[&str; 5]; 6] = [
    ["RelPose", "RGB", "58.3", "26.1", "7.0"],
    ["RelPose++", "RGB", "46.6", "42.5", "15.8"],
    ["3DAHV", "RGB", "41.7", "61.5", "29.9"],
    ["DVMNet", "RGB", "36.8", "-", "-"],
    ["UNOPose (predicted depth)", "RGB", "49.1", "50.0", "19.1"],
    ["UNOPose", "RGB-D", "23.9", "84.2", "81.1"],
];

/// A row of the ablations on YCB-V.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PublishedAblation {
    pub row: &'static str,
    pub switches: Switches,
    /// VSD, MSSD, MSPD, AR.
    pub scores: [f64; 4],
}

/// The ablations of the network's ingredients; empty for other datasets than YCB-V.
pub(crate) fn published_ablation(dataset: &str) -> Vec<PublishedAblation> {
    if plain(dataset) != "ycbv" {
        return Vec::new();
    }
    let row = |&(row, [grf, lrf, fine, overlap], scores): &(&'static str, [u8; 4], [f64; 4])| {
        let [grf, lrf, fine, overlap] = [grf, lrf, fine, overlap].map(|switch| switch == 1);
        PublishedAblation { row, switches: Switches { grf, lrf, fine, overlap }, scores }
    };
    ABLATION.iter().map(row).collect()
}

/// Row, GRF, LRF, fine pose estimation, overlap predictor, scores.
const ABLATION: [(&str, [u8; 4], [f64; 4]); 10] = [
    ("A0", [0, 0, 0, 0], [64.6, 68.1, 59.2, 63.9]),
    ("A1", [1, 0, 0, 0], [66.4, 72.8, 63.2, 67.5]),
    ("A2", [0, 1, 0, 0], [66.2, 69.5, 60.4, 65.4]),
    ("A3", [1, 1, 0, 0], [66.9, 73.2, 63.5, 67.9]),
    ("C2", [1, 1, 0, 1], [68.4, 74.6, 64.8, 69.2]),
    ("B0", [0, 0, 1, 0], [79.8, 85.0, 75.5, 80.1]),
    ("B1", [1, 0, 1, 0], [79.4, 85.2, 76.6, 80.4]),
    ("B2", [0, 1, 1, 0], [81.1, 85.1, 76.6, 80.9]),
    ("B3", [1, 1, 1, 0], [80.7, 86.0, 77.7, 81.5]),
    ("C1", [1, 1, 1, 1], [82.6, 87.4, 79.4, 83.1]),
];

fn plain(dataset: &str) -> String {
    dataset.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase()
}
