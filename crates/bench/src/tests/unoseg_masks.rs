//! Our own segmentation beside the poses made with it.

use std::sync::atomic::AtomicUsize;

use unopose_dataset::{
    formats::{DatasetSplits, Target, detections::read_detections},
    protocol::Protocol,
};
use unopose_eval::metrics::score_segmentation;
use unopose_pairs::registration::Refinement;

use super::{super::*, Shift, write_dataset};

#[test]
fn unoseg_masks_are_a_table_of_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_dataset(folder.path());
    let (root, out) = (folder.path().join("ycbv"), folder.path().join("out"));
    // The right mask of one image of two.
    let found = read_detections(&root.join("dets.json"), None).unwrap();
    let found = &found[..1];
    let targets = [1, 2].map(|im_id| Target { scene_id: 1, im_id, obj_id: 1, inst_count: 1 });
    let seconds: [&[f64]; 2] = [&[0.5, 1.5], &[0.25, 0.25]];
    let scores = score_segmentation(&list.split, &targets, found, found, seconds).unwrap();
    let row = |proposals: &str| UnoSegMasks {
        proposals: proposals.into(),
        matcher: "checkpoint".into(),
        scores: scores.clone(),
        detections: root.join("dets.json"),
    };
    let request = ListRequest {
        splits: DatasetSplits { dataset: root.clone(), ..DatasetSplits::default() },
        targets: Some(root.join("targets.json")),
        detections: DetectionSource::UnoSeg(row("embedded")),
        limit: None,
        seed: 5,
        rendered: false,
    };
    let PreparedList { mut facts, list } = request.prepare(&[Protocol::Rot50], &out).unwrap().remove(0);
    assert_eq!((facts.segmentation.as_str(), facts.unoseg_masks.len()), ("unoseg (embedded)", 1));
    assert_eq!((list.detections.len(), facts.mask_map), (1, None));
    facts.unoseg_masks.push(row("listed-fastsam"));
    let methods = [Method { estimator: Box::new(Shift { asked: AtomicUsize::new(0) }), switches: None }];
    let suite = Suite {
        methods: &methods,
        refinements: &[Refinement::None],
        ablation: &[],
        cache: &folder.path().join("results"),
        score_targets: None,
        seed: 1,
        progress: &|_, _, _| {},
    };
    suite.run(&list, &facts, &out).unwrap();
    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    // 101 points of recall, of which those up to 0.5 have precision 1.
    let cells = "| checkpoint | 50.5 | 50.5 | 50.0 | 50.0 | 0.5 | 1.000 |";
    for source in ["embedded", "listed-fastsam"] {
        assert!(text("table.md").contains(&format!("| {source} {cells}")), "{}", text("table.md"));
        let row = format!("<td>{source}</td><td>checkpoint</td><td>50.5</td>");
        assert!(text("index.html").contains(&row), "{}", text("index.html"));
    }
    let csv = text("segmentation.csv");
    let row = "embedded,checkpoint,0.504950,0.504950,0.500000,0.500000,2,0.50,1.0000,0.2500";
    assert_eq!(csv.lines().nth(1), Some(row), "{csv}");
    let json: serde_json::Value =
        unopose_dataset::formats::files::read_json(&out.join("table.json")).unwrap();
    assert_eq!(json["own_masks"][1]["proposals"].as_str(), Some("listed-fastsam"));
    assert_eq!(json["own_masks"][1]["recall75"].as_f64(), Some(0.5));
}
