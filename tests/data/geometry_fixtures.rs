//! Every geometric step against the official implementation's tensors, at the tolerances the tensors came with.

use unopose_core::{
    config::HypothesisConfig,
    geometry::{
        CoarsePose, GlobalReferenceFrame, LocalFrames, Pose, ball_groups, ball_query, coarse_pose,
        farthest_point_sampling, fine_pose, match_assignment, match_distribution, structure_indices,
        weighted_procrustes,
    },
};
use unopose_tests::reference_tensors::{ReferenceTensors, max_difference};

fn rotation_difference(pose: &Pose, expected: &[f32]) -> f32 {
    max_difference(pose.rotation_row_major().map(|r| r as f32), expected)
}

fn translation_difference(pose: &Pose, expected: &[f32]) -> f32 {
    max_difference(pose.translation.iter().map(|&t| t as f32), expected)
}

#[test]
fn farthest_point_sampling_takes_the_kernels_order() {
    let file = ReferenceTensors::open("fps");
    for case in [
        "all_points",
        "duplicates",
        "large",
        "lattice_ties",
        "near_origin",
        "random",
        "surface",
        "two_points",
    ] {
        for i in 0..file.batch(&format!("{case}.xyz")) {
            let expected = file.int_item(&format!("{case}.idx"), i);
            let points = file.cloud(&format!("{case}.xyz"), i);
            let got: Vec<i64> =
                farthest_point_sampling(&points, expected.len()).iter().map(|&k| k as i64).collect();
            assert_eq!(got, expected, "{case}[{i}]");
        }
    }
}

#[test]
fn global_reference_frame_matches() {
    let file = ReferenceTensors::open("grf");
    for case in ["partial", "ref", "rotated", "planar_3mm", "planar_0p2mm", "tiny"] {
        for i in 0..file.batch(&format!("{case}.pts")) {
            let name = |part: &str| format!("{case}.{part}");
            let frame = GlobalReferenceFrame::new(&file.cloud(&name("pts"), i), true);
            let check = |part: &str, got: Vec<f32>| {
                let worst = max_difference(got, &file.item(&name(part), i));
                // The release rounds the centroid to single precision: 0.1 um, which a cloud of 0.2 mm shows.
                let tolerance = if case == "planar_0p2mm" { 4e-5 } else { 2e-5 };
                assert!(worst < tolerance, "{case}[{i}].{part} differs by {worst:e}");
            };
            check("centroid", frame.centroid.iter().map(|&c| c as f32).collect());
            check("radius", vec![frame.radius as f32]);
            check("cov", frame.covariance.transpose().iter().map(|&c| c as f32).collect());
            check("singular_values", frame.singular_values.iter().map(|&s| s as f32).collect());
            assert_eq!(frame.axes.sign_count, file.int_item(&name("sign_count"), i)[0], "{case}[{i}]");
            check("out", frame.coordinates.concat());
        }
    }
}

#[test]
fn ball_query_takes_the_first_in_index_order() {
    let file = ReferenceTensors::open("lrf_group");
    let query = ball_query(&file.cloud("bq.new_xyz", 0), &file.cloud("bq.xyz", 0), 0.3, 8);
    let expected = file.int_item("bq.idx_r0p3_s8", 0);
    assert_eq!(query.indices.iter().map(|&i| i as i64).collect::<Vec<_>>(), expected);
}

#[test]
fn ball_groups_match() {
    let file = ReferenceTensors::open("lrf_group");
    for cloud in ["cloud", "isolated"] {
        let points = file.cloud(&format!("{cloud}.xyz"), 0);
        for scale in ["g1", "g2"] {
            let name = |part: &str| format!("{cloud}.{scale}.{part}");
            let samples = file.int_item(&name("nsample"), 0)[0] as usize;
            let radius = file.item(&name("radius"), 0)[0];
            let groups = ball_groups(&points, radius, samples, Some(LocalFrames::RELEASE));
            let distinct = file.int_item(&name("n_distinct"), 0);
            assert_eq!(groups.counts.iter().map(|&c| c as i64).collect::<Vec<_>>(), distinct);

            // [6, N, samples] there, [N, samples, 6] here.
            let expected = file.item(&name("out"), 0);
            let mut frame_errors = Vec::new();
            for (entry, features) in groups.features.chunks_exact(6).enumerate() {
                for (c, &got) in features.iter().enumerate() {
                    let error = (got - expected[c * points.len() * samples + entry]).abs();
                    if c < 3 {
                        assert!(error < 1e-6, "{cloud}.{scale} offset {error:e}");
                    } else {
                        frame_errors.push(error);
                    }
                }
            }
            frame_errors.sort_by(f32::total_cmp);
            let (worst, median) =
                (frame_errors[frame_errors.len() - 1], frame_errors[frame_errors.len() / 2]);
            println!("{cloud}.{scale} local frame: worst {worst:e}, median {median:e}");
            assert!(worst < 2e-3, "{cloud}.{scale} local frame {worst:e}");
            assert!(median < 1e-6, "{cloud}.{scale} local frame median {median:e}");
        }
    }
}

#[test]
fn structure_indices_match() {
    let file = ReferenceTensors::open("geo_embedding");
    for i in 0..file.batch("points") {
        let points = file.cloud("points", i);
        let got = structure_indices(&points, 0.2, 15.0, 3);
        let expected = file.item("d_indices", i);
        for (entry, (&d, &e)) in got.distances.iter().zip(&expected).enumerate() {
            // The release's diagonal holds the rounding of its matrix product.
            let tolerance = if entry % (points.len() + 1) == 0 { 5e-3 } else { 1e-4 };
            assert!((d - e).abs() < tolerance, "d_indices[{i}][{entry}] = {d}, expected {e}");
        }
        let worst = max_difference(got.angles, &file.item("a_indices", i));
        assert!(worst < 1e-4, "a_indices[{i}] {worst:e}");
    }
}

#[test]
fn procrustes_matches() {
    let file = ReferenceTensors::open("procrustes");
    for (case, rotation_tolerance, translation_tolerance) in [
        ("all_below_thresh", 2e-5, 5e-5),
        ("planar", 2e-5, 5e-5),
        ("reflection", 2e-5, 5e-5),
        ("small_weights", 1e-3, 1e-3),
        ("three_points", 2e-5, 5e-5),
        ("thresholded", 2e-5, 5e-5),
        ("unweighted", 2e-5, 5e-5),
        ("weighted", 2e-5, 5e-5),
    ] {
        let name = |part: &str| format!("{case}.{part}");
        let threshold = file.item(&name("weight_thresh"), 0)[0];
        for i in 0..file.batch(&name("src")) {
            let weights = file.contains(&name("weights")).then(|| file.item(&name("weights"), i));
            let (src, dst) = (file.cloud(&name("src"), i), file.cloud(&name("ref"), i));
            let pose = weighted_procrustes(&src, &dst, weights.as_deref(), threshold);
            let rotation = rotation_difference(&pose, &file.item(&name("R"), i));
            let translation = translation_difference(&pose, &file.item(&name("t"), i));
            assert!(rotation < rotation_tolerance, "{case}[{i}] R {rotation:e}");
            assert!(translation < translation_tolerance, "{case}[{i}] t {translation:e}");
        }
    }
}

/// Where the tensors of one coarse solution are found and how closely they must be met.
struct CoarseCase<'a> {
    file: &'a ReferenceTensors,
    prefix: &'a str,
    similarity: &'a str,
    scores: &'a str,
    clouds: [&'a str; 2],
    uniform: &'a str,
}

impl CoarseCase<'_> {
    fn check(&self, item: usize) {
        let file = self.file;
        let name = |part: &str| format!("{}{part}", self.prefix);
        let (query, reference) = (file.cloud(self.clouds[0], item), file.cloud(self.clouds[1], item));
        let scores = file.item(self.scores, item);
        let (overlap_query, overlap_reference) = scores.split_at(query.len());
        let assignment =
            match_assignment(&file.item(self.similarity, item), overlap_query, overlap_reference);
        let worst = max_difference(assignment.weights.iter().copied(), &file.item(&name("assignment"), item));
        assert!(worst < 2e-6, "assignment {worst:e}");
        let labels = |l: &[u32]| l.iter().map(|&l| l as i64).collect::<Vec<_>>();
        assert_eq!(labels(&assignment.label_query), file.int_item(&name("label1"), item));
        assert_eq!(labels(&assignment.label_reference), file.int_item(&name("label2"), item));
        let cumulative = match_distribution(&assignment, 1.5);
        assert!(max_difference(cumulative, &file.item(&name("cumsum"), item)) < 2e-6);

        let uniforms = file.item(self.uniform, item);
        let kept = file.int_item(&name("topk_idx"), item);
        let config = HypothesisConfig {
            proposals: uniforms.len() / 3,
            kept: kept.len(),
            ..HypothesisConfig::default()
        };
        let mut stream = uniforms.iter().copied();
        let coarse = coarse_pose(&assignment, &query, &reference, &config, || stream.next().unwrap(), true);
        self.check_pairs(&coarse, item, query.len(), reference.len());
        self.check_hypotheses(&coarse, item);
        self.check_winner(&coarse, item);
    }

    fn check_pairs(&self, coarse: &CoarsePose, item: usize, queries: usize, references: usize) {
        let expected = self.file.int_item(&format!("{}pair_idx", self.prefix), item);
        let drawn = coarse.hypotheses.iter().flat_map(|h| h.pairs);
        for ((i, j), &index) in drawn.zip(&expected) {
            let index = index as usize;
            assert_eq!((i as usize, j as usize), ((index / references).min(queries - 1), index % references));
        }
    }

    fn check_hypotheses(&self, coarse: &CoarsePose, item: usize) {
        let name = |part: &str| format!("{}{part}", self.prefix);
        let degenerate = self.file.int_item(&name("degenerate"), item);
        let (r, t) = (self.file.item(&name("hyp_R"), item), self.file.item(&name("hyp_t"), item));
        let residuals = self.file.item(&name("hyp_dis"), item);
        for (k, hypothesis) in coarse.hypotheses.iter().enumerate().filter(|(k, _)| degenerate[*k] == 0) {
            let rotation = rotation_difference(&hypothesis.pose, &r[9 * k..9 * k + 9]);
            let translation = translation_difference(&hypothesis.pose, &t[3 * k..3 * k + 3]);
            assert!(rotation < 2e-4, "hypothesis {k} R {rotation:e}");
            assert!(translation < 1e-3, "hypothesis {k} t {translation:e}");
            assert!((hypothesis.residual as f32 - residuals[k]).abs() < 1e-5, "hypothesis {k} residual");
        }
        let scores = self.file.item(&name("topk_scores"), item);
        for (&k, &expected) in self.file.int_item(&name("topk_idx"), item).iter().zip(&scores) {
            let Some(slot) = coarse.kept.iter().position(|&kept| kept == k as usize) else {
                // Degenerate triplets have arbitrary poses and residuals, so others may take the last places.
                let cutoff = coarse.hypotheses[coarse.kept[coarse.kept.len() - 1]].residual;
                let gained = coarse.kept.iter().any(|&kept| degenerate[kept] == 1);
                let near_tie = coarse.hypotheses[k as usize].residual - cutoff < 1e-6;
                assert!(degenerate[k as usize] == 1 || gained || near_tie, "hypothesis {k} should be kept");
                continue;
            };
            if degenerate[k as usize] == 0 {
                let score = coarse.kept_scores[slot] as f32;
                // Squared distances of the release are good to 1e-5, which is 1 % at a distance of 0.03.
                assert!((score - expected).abs() <= 2e-3 * expected, "score {score}, expected {expected}");
            }
        }
    }

    fn check_winner(&self, coarse: &CoarsePose, item: usize) {
        let name = |part: &str| format!("{}{part}", self.prefix);
        let kept = self.file.int_item(&name("topk_idx"), item);
        let winner = kept[self.file.int_item(&name("best"), item)[0] as usize];
        if self.file.int_item(&name("degenerate"), item)[winner as usize] == 1 {
            println!("{}[{item}]: the release's winner is degenerate", self.prefix);
            return;
        }
        assert_eq!(coarse.best.map(|b| coarse.kept[b] as i64), Some(winner));
        let score = self.file.item(&name("score"), item)[0];
        assert!((coarse.score as f32 - score).abs() <= 1e-3 * score);
        assert!(rotation_difference(&coarse.pose, &self.file.item(&name("R"), item)) < 1e-4);
        assert!(translation_difference(&coarse.pose, &self.file.item(&name("t"), item)) < 1e-3);
    }
}

#[test]
fn coarse_pose_matches() {
    let file = ReferenceTensors::open("coarse_pose");
    for case in ["clean", "noisy", "all_background"] {
        let name = |part: &str| format!("{case}.{part}");
        let (prefix, similarity, scores) = (name(""), name("atten"), name("scores"));
        let (query, reference, uniform) = (name("pts1"), name("pts2"), name("uniform"));
        for item in 0..file.batch(&query) {
            CoarseCase {
                file: &file,
                prefix: &prefix,
                similarity: &similarity,
                scores: &scores,
                clouds: [&query, &reference],
                uniform: &uniform,
            }
            .check(item);
        }
    }
}

#[test]
fn nothing_matched_scores_zero() {
    let file = ReferenceTensors::open("coarse_pose");
    let (query, reference) = (file.cloud("all_background.pts1", 0), file.cloud("all_background.pts2", 0));
    let scores = file.item("all_background.scores", 0);
    let assignment = match_assignment(&file.item("all_background.atten", 0), &scores[..20], &scores[20..]);
    let config = HypothesisConfig { proposals: 100, kept: 10, ..HypothesisConfig::default() };
    for degenerate_allowed in [true, false] {
        let coarse = coarse_pose(&assignment, &query, &reference, &config, || 0.5, degenerate_allowed);
        assert_eq!(coarse.score, 0.0);
        assert!(coarse.pose.rotation_defect() < 1e-9);
    }
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn coarse_pose_of_the_whole_chain_matches() {
    let file = ReferenceTensors::open("e2e_eval");
    for item in 0..2 {
        CoarseCase {
            file: &file,
            prefix: "hyp.",
            similarity: "coarse_sim0",
            scores: "coarse_scores",
            clouds: ["sparse_pm", "sparse_po"],
            uniform: "uniform",
        }
        .check(item);
    }
}

#[test]
fn fine_pose_matches() {
    let file = ReferenceTensors::open("fine_pose");
    check_fine_pose(&file, "", "atten", "scores", ["pts1", "pts2"]);
}

#[test]
#[cfg_attr(not(has_shared), ignore = "needs the shared folder: UNOPOSE_SHARED")]
fn fine_pose_matches_in_the_chain() {
    let file = ReferenceTensors::open("e2e_eval");
    check_fine_pose(&file, "finepose.", "fine_sim0", "fine_scores", ["dense_pm", "dense_po"]);
}

fn check_fine_pose(file: &ReferenceTensors, prefix: &str, similarity: &str, scores: &str, clouds: [&str; 2]) {
    for item in 0..2 {
        let (query, reference) = (file.cloud(clouds[0], item), file.cloud(clouds[1], item));
        let scores = file.item(scores, item);
        let assignment =
            match_assignment(&file.item(similarity, item), &scores[..query.len()], &scores[query.len()..]);
        let fine = fine_pose(&assignment, &query, &reference);
        let name = |part: &str| format!("{prefix}{part}");
        let labels = |l: &[u32]| l.iter().map(|&l| l as i64).collect::<Vec<_>>();
        assert_eq!(labels(&assignment.label_query), file.int_item(&name("label1"), item));
        assert_eq!(labels(&assignment.label_reference), file.int_item(&name("label2"), item));
        let weights = max_difference(fine.weights, &file.item(&name("assign_weight"), item));
        assert!(weights < 1e-5, "weights {weights:e}");
        let predicted = max_difference(fine.predicted.concat(), &file.item(&name("pred_pts"), item));
        assert!(predicted < 2e-5, "predicted points {predicted:e}");
        assert!(rotation_difference(&fine.pose, &file.item(&name("R"), item)) < 2e-5);
        assert!(translation_difference(&fine.pose, &file.item(&name("t"), item)) < 1e-4);
        let expected = file.item(&name("nn_dis"), item);
        for (&d, &e) in fine.distances.iter().zip(&expected) {
            // The release's squared distances are good to about 1e-5.
            assert!((d * d - e * e).abs() < 3e-5, "distance {d}, expected {e}");
        }
        assert!((fine.score as f32 - file.item(&name("score"), item)[0]).abs() < 1e-6);
    }
}
