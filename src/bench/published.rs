//! The paper's Table 2 ("Pose estimation results on LM-O, TUD-L, and YCB-V"): AR_BOP in percent.

/// A row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedRow {
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

/// The rows for a dataset, by the name of its folder (`lmo`, `tudl`, `ycbv`, dashes and case do not matter); empty for
/// any other.
pub fn published_rows(dataset: &str) -> Vec<PublishedRow> {
    let name: String = dataset.chars().filter(char::is_ascii_alphanumeric).collect();
    let Some(column) = ["lmo", "tudl", "ycbv"].iter().position(|known| name.eq_ignore_ascii_case(known))
    else {
        return Vec::new();
    };
    let row = |&(method, segmentation, ars, seconds): &(&'static str, &'static str, [f64; 3], f64)| {
        PublishedRow { method, segmentation, ar: ars[column], seconds }
    };
    TABLE.iter().map(row).collect()
}
