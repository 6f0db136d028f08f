//! Scores of the benchmark's result tables against those of the official toolkit.
//!
//! Measured agreement is printed with `--nocapture`.

use std::{collections::BTreeMap, path::Path, time::Instant};

use serde::Deserialize;
use unopose_dataset::formats::{
    BopDataset, DatasetSplits, detections::read_detections, files::read_json, targets::read_targets,
};
use unopose_eval::metrics::{Evaluation, RegionKind, ScoreFiles, coco_scores, score_files};

/// Any recall is a multiple of 1/406; the tables' own rounding can move a single instance over a threshold.
const AR_TOLERANCE: f64 = 1e-3;
/// MSPD beyond this is compared as being this.
const FAR_PIXELS: f64 = 1e4;

#[derive(Deserialize)]
struct OracleScores {
    #[serde(rename = "AR")]
    ar: f64,
    #[serde(rename = "AR_VSD")]
    ar_vsd: f64,
    #[serde(rename = "AR_MSSD")]
    ar_mssd: f64,
    #[serde(rename = "AR_MSPD")]
    ar_mspd: f64,
}

#[derive(Deserialize)]
struct OracleErrors {
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    vsd: [f64; 10],
    /// Millimetres, null when infinite.
    mssd: Option<f64>,
    mspd: f64,
}

fn compare(benchmark: &Path, method: &str, references: Option<&str>) -> Evaluation {
    let oracle = benchmark.join("oracle");
    let files = ScoreFiles {
        splits: DatasetSplits { dataset: benchmark.to_path_buf(), ..DatasetSplits::default() },
        results: oracle.join(format!("{method}_dev-test.csv")),
        targets: None,
        references: references.map(|name| benchmark.join(name)),
    };
    let start = Instant::now();
    let evaluation = score_files(&files, &|_, _| {}).unwrap();
    let seconds = start.elapsed().as_secs_f64();

    let expected: OracleScores = read_json(&oracle.join(format!("scores_{method}.json"))).unwrap();
    let recall = &evaluation.scores.recall;
    let pairs = [
        ("AR", recall.ar, expected.ar),
        ("AR_VSD", recall.ar_vsd, expected.ar_vsd),
        ("AR_MSSD", recall.ar_mssd, expected.ar_mssd),
        ("AR_MSPD", recall.ar_mspd, expected.ar_mspd),
    ];
    let largest = pairs.iter().map(|(_, a, b)| (a - b).abs()).fold(0.0, f64::max);
    let [vsd, mssd, mspd] = largest_differences(&evaluation, &oracle.join(format!("errors_{method}.json")));
    println!(
        "{method}: AR {:.6}, largest AR difference {largest:.1e}, per target: VSD {vsd:.1e}, MSSD {mssd:.1e} mm, \
         MSPD {mspd:.1e} px, {seconds:.2} s",
        recall.ar
    );
    assert_eq!(recall.n_targets, 406);
    for (name, met, expected) in pairs {
        assert!(
            (met - expected).abs() < AR_TOLERANCE,
            "{method}: {name} is {met}, the toolkit says {expected}"
        );
    }
    // Tables hold micrometres and nine digits of rotation.
    assert!(mssd < 1e-3 && mspd < 1e-3, "{method}: MSSD {mssd} mm, MSPD {mspd} px");
    // A pixel at a silhouette or at a tolerance may fall to the other side; objects cover 150 pixels and
    // more.
    assert!(vsd < 7e-3, "{method}: VSD {vsd}");
    evaluation
}

/// Largest differences of VSD, MSSD (mm) and MSPD (px) over all targets.
fn largest_differences(evaluation: &Evaluation, errors: &Path) -> [f64; 3] {
    let oracle: Vec<OracleErrors> = read_json(errors).unwrap();
    let oracle: BTreeMap<_, _> = oracle.into_iter().map(|e| ((e.scene_id, e.im_id, e.obj_id), e)).collect();
    let mut largest = [0f64; 3];
    for target in &evaluation.targets {
        let expected = &oracle[&(target.scene_id, target.im_id, target.obj_id)];
        let errors = target.errors.as_ref().expect("every target has an estimate");
        let vsd = errors.vsd.iter().zip(&expected.vsd).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let mssd = match expected.mssd {
            Some(mssd) => (errors.mssd * 1000.0 - mssd).abs(),
            None if errors.mssd.is_infinite() => 0.0,
            None => f64::INFINITY,
        };
        // A vertex near the camera plane projects millions of pixels away, wherever the table's rounding puts
        // it.
        let mspd = (errors.mspd.min(FAR_PIXELS) - expected.mspd.min(FAR_PIXELS)).abs();
        let difference = [vsd, mssd, mspd];
        largest = std::array::from_fn(|i| largest[i].max(difference[i]));
    }
    largest
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn groups_hold_the_targets_of_the_benchmark() {
    let benchmark = unopose_tests::shared("bench/dev");
    let references = "test_ref_targets_crossscene_rot50.json";
    let scores = compare(&benchmark, "fpfhransacicpnoisydet", Some(references)).scores;
    let bins: Vec<_> = scores.per_rotation.iter().map(|b| (b.to, b.recall.n_targets)).collect();
    assert_eq!(bins, [(10.0, 20), (20.0, 72), (30.0, 89), (40.0, 116), (50.0, 109)]);
    let bins: Vec<_> = scores.per_visibility.iter().map(|b| b.recall.n_targets).collect();
    assert_eq!(bins, [1, 15, 39, 45, 306]);
    let objects: Vec<_> = scores.per_object.values().map(|r| r.n_targets).collect();
    assert_eq!(objects, [48, 36, 48, 34, 36, 41, 38, 46, 31, 48]);
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn all_tables_score_as_in_the_toolkit() {
    let benchmark = unopose_tests::shared("bench/dev");
    let names = std::fs::read_dir(benchmark.join("oracle")).unwrap();
    let mut methods: Vec<String> = names
        .filter_map(|f| Some(f.unwrap().file_name().to_str()?.strip_suffix("_dev-test.csv")?.to_owned()))
        .collect();
    methods.sort();
    assert_eq!(methods.len(), 14);
    for method in methods {
        compare(&benchmark, &method, None);
    }
}

/// Against pycocotools 2.0 with the `ignore` flag of the annotations kept.
#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn noisy_masks_score_as_in_pycocotools() {
    let benchmark = unopose_tests::shared("bench/dev");
    let dataset = BopDataset::open(&benchmark).unwrap();
    let split = dataset.test_split().unwrap();
    let targets = read_targets(&dataset.file("test_targets_bop19.json")).unwrap();
    let detections = read_detections(&benchmark.join("dets_noisy_dev.json"), None).unwrap();
    for (kind, expected) in [
        (RegionKind::Mask, [0.691772492766083, 0.9168316831683169, 0.900685088566623, 0.710390873015873]),
        (RegionKind::Box, [0.6783310660988603, 0.8979820251757035, 0.824288439167149, 0.7310813492063493]),
    ] {
        let scores = coco_scores(&split, &targets, &detections, kind).unwrap();
        assert_eq!((scores.n_instances, scores.n_ignored, scores.n_outside), (443, 1, 0));
        let met = [scores.map, scores.ap50, scores.ap75, scores.ar100];
        for (met, expected) in met.iter().zip(expected) {
            assert!((met - expected).abs() < 1e-9, "{kind:?}: {scores:?}");
        }
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn ground_truth_detections_decode_to_the_visible_masks() {
    let benchmark = unopose_tests::shared("bench/dev");
    let split = BopDataset::open(&benchmark).unwrap().test_split().unwrap();
    let detections = read_detections(&benchmark.join("dets_gt_dev.json"), None).unwrap();
    assert_eq!(detections.len(), 406);
    for detection in detections.iter().step_by(9) {
        let mask = detection.segmentation.decode().unwrap();
        let image = split.load(detection.scene_id, detection.image_id).unwrap();
        let same = image.instances.iter().any(|i| {
            i.obj_id == detection.category_id
                && i.mask_visib == mask
                && i.px_count_visib as usize == mask.count()
        });
        assert!(same, "object {} in image {}", detection.category_id, detection.image_id);
    }
}
