//! What each correction of the release's quirks changes, in numbers; they are counted as in `docs/network.md`, section 10.
//! (8 is tested beside the augmentation in `unopose-pairs`, 9 in `tests/data/pairs.rs`.)

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::{
        Config, DataConfig, FineConfig, HypothesisConfig, MatchingConfig, ModelConfig, OverlapMode,
        PoseNoiseConfig, Quirks,
    },
    geometry::{
        BallGroups, Pose, ball_groups, coarse_pose, global_reference_frame, match_assignment,
        radius_about_mean,
    },
};
use unopose_dataset::formats::ObjectSymmetries;
use unopose_infer::host_assignments;
use unopose_nn::{
    loss::pairwise_distance,
    model::{BlockOutput, CloudTensors, Initializer, PositionalEncoding, group_tensors},
};
use unopose_pairs::data::{
    PairSampler, PoseNoise, PreparedReference, metric_pose, positional_groups, prepare_reference,
    query_from_points,
};
use unopose_tests::ellipsoid_views::EllipsoidViews;

fn model(edit: impl FnOnce(&mut Quirks)) -> ModelConfig {
    let mut quirks = Quirks::corrected();
    edit(&mut quirks);
    ModelConfig {
        image_size: 56,
        reference_points: 600,
        fine_points: 256,
        coarse_points: 48,
        quirks,
        ..ModelConfig::default()
    }
}

fn reference(config: &ModelConfig) -> PreparedReference {
    let views = EllipsoidViews::new(1, 3);
    let frame = &views.frames[0];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    prepare_reference(&frame.frame, &frame.instances[0].mask_visib, config, &mut rng).unwrap()
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f64 {
    (0..3).map(|i| ((a[i] - b[i]) as f64).powi(2)).sum::<f64>().sqrt()
}

/// 1: the structure embedding of the reference belongs to its sparse points.
#[test]
fn structure_distances_are_those_of_the_sparse_points() {
    let mean_error = |misaligned| {
        let config = model(|q| q.misaligned_reference_grf = misaligned);
        let cloud = reference(&config).cloud;
        // The frame's coordinates are in units of the same radius, so distances agree.
        let sigma = config.geo_embedding.sigma_d as f64;
        let (size, sparse) = (cloud.structure.size, &cloud.sparse);
        let point = |i: usize| &cloud.points[sparse[i] as usize];
        let errors = (0..sparse.len()).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| {
            let stored = cloud.structure.distances[(i + 1) * size + j + 1] as f64 * sigma;
            (stored - distance(point(i), point(j))).abs()
        });
        let errors: Vec<f64> = errors.collect();
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    let (corrected, release) = (mean_error(false), mean_error(true));
    assert!(corrected < 1e-3, "{corrected}");
    assert!(release > 0.2, "{release}");
}

/// 2: a sparse token is that of its own point.
#[test]
fn sparse_tokens_are_shifted_past_the_background() {
    let rows = |off_by_one| {
        let config = model(|q| q.sparse_off_by_one = off_by_one);
        let cloud = reference(&config).cloud;
        let tensors = CloudTensors::from_clouds(&[&cloud, &cloud], &config, &Device::flex());
        (tensors.rows.tokens.try_into_vec_as::<i64>().unwrap(), cloud)
    };
    let ((corrected, cloud), (release, _)) = (rows(false), rows(true));
    let tokens = cloud.points.len() as i64 + 1;
    for (b, (corrected, release)) in corrected.chunks(49).zip(release.chunks(49)).enumerate() {
        let base = b as i64 * tokens;
        assert_eq!((corrected[0], release[0]), (base, base));
        for (j, &index) in cloud.sparse.iter().enumerate() {
            // Token k of an item is its point k - 1.
            assert_eq!(corrected[j + 1], base + index as i64 + 1);
            assert_eq!(release[j + 1], base + index as i64);
        }
    }
}

/// 3: the reference's overlaps begin after the query's.
#[test]
fn overlap_scores_are_split_at_the_querys_count() {
    let device = Device::flex();
    let tensor =
        |values: &[f32], n: usize| Tensor::<2>::from_data(TensorData::new(values.to_vec(), [1, n]), &device);
    let logit = |p: f32| (p / (1.0 - p)).ln();
    let query: Vec<f32> = [0.9, 0.8, 0.7].map(logit).into();
    let block = |reference: &[f32]| BlockOutput {
        similarity: Tensor::zeros([1, 4, reference.len() + 1], &device),
        overlap: Some([tensor(&query, 3), tensor(reference, reference.len())]),
        background_overlap: None,
    };
    let weights = |block: &BlockOutput, split| {
        host_assignments(block.clone(), OverlapMode::Release, split)
            .map(|mut m| m.remove(0).assignment.weights)
    };
    // Equal similarities: 1 / (rows * columns) times both overlaps. Three query points, two of the reference.
    let unequal = block(&[0.5, 0.25].map(logit));
    let corrected = weights(&unequal, false).unwrap();
    assert!((corrected[3 + 1] - 0.9 * 0.5 / 12.0).abs() < 1e-6, "{corrected:?}");
    assert!((corrected[3 * 3 + 2] - 0.7 * 0.25 / 12.0).abs() < 1e-6, "{corrected:?}");
    // The release takes the scores from position 2 on, three of them for two points, and stops.
    let error = weights(&unequal, true).unwrap_err().to_string();
    assert!(error.contains("3 query and 2 reference points"), "{error}");
    let equal = block(&[0.5, 0.25, 0.125].map(logit));
    assert_eq!(weights(&equal, true).unwrap(), weights(&equal, false).unwrap());
}

/// 4: the initial translation of training stays near the true one.
#[test]
fn noisy_translations_are_not_pushed_in_front_of_the_camera() {
    let config = PoseNoiseConfig::default();
    let noise = PoseNoise { angles_deg: [0.0; 3], translation: [0.1, 0.0, -0.2] };
    let truth = Pose::new(Matrix3::identity(), Vector3::new(0.3, -0.2, -4.0));
    let error = |clamp| noise.apply(&truth, &config, clamp).translation_distance(&truth);
    assert!((error(false) - 0.05f64.sqrt()).abs() < 1e-12);
    assert!((error(true) - (4.0f64.powi(2) + 0.01).sqrt()).abs() < 1e-5, "{}", error(true));
}

/// 5: distances of centred clouds keep their digits.
#[test]
fn centred_clouds_have_exact_distances() {
    let points: Vec<[f32; 3]> = {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        (0..256).map(|_| [0.0, 0.0, 1.4f32].map(|c| c + rng.random_range(-0.1..0.1f32))).collect()
    };
    let choose = vec![0; points.len()];
    let (_, radius) = radius_about_mean(&points);
    let mut poses = Vec::new();
    let worst = |uncentred, poses: &mut Vec<Pose>| {
        let config = model(|q| q.uncentred_clouds = uncentred);
        let cloud = query_from_points(&points, &choose, Vec::new(), radius, &config);
        poses.push(metric_pose(&Pose::identity(), cloud.center, cloud.center, radius));
        let n = cloud.points.len();
        let data = TensorData::new(cloud.points.as_flattened().to_vec(), [1, n, 3]);
        let tensor = Tensor::<3>::from_data(data, &Device::flex());
        let distances = pairwise_distance(tensor.clone(), tensor).try_into_vec_as::<f32>().unwrap();
        let unit = f64::from(radius) + 1e-6;
        let error =
            |k: usize| (f64::from(distances[k]) - distance(&points[k / n], &points[k % n]) / unit).abs();
        (0..n * n).map(error).fold(0.0, f64::max)
    };
    let (corrected, release) = (worst(false, &mut poses), worst(true, &mut poses));
    // At 14 radii from the origin a coordinate has steps of 1e-6.
    assert!(corrected < 5e-7 && release > 8e-7, "{corrected} {release}");
    // The pose between the cameras does not depend on the choice.
    assert!(poses[0].translation_distance(&poses[1]) < 1e-9);
}

/// 6: the sign of a frame does not depend on the unit of length.
#[test]
fn the_sign_of_a_frame_survives_small_objects() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    // A shallow, skewed bowl: its third moment across the least direction is far from 0.
    let bowl: Vec<[f32; 3]> = (0..200)
        .map(|_| {
            let (x, y) = (rng.random_range(-0.1..0.1f32), rng.random_range(-0.06..0.06f32));
            [x, y, 8.0 * (x * x + y * y) + 0.1 * x * y]
        })
        .collect();
    let mirrored: Vec<[f32; 3]> = bowl.iter().map(|p| [p[0], p[1], -p[2]]).collect();
    // Largest change of a height when the object shrinks to a thousandth.
    let change = |points: &[[f32; 3]], counted: bool| {
        let small: Vec<[f32; 3]> = points.iter().map(|p| p.map(|v| v * 1e-3)).collect();
        let [a, b] = [points, &small].map(|p| global_reference_frame(p, counted));
        a.iter().zip(&b).map(|(a, b)| (a[2] - b[2]).abs()).fold(0.0, f32::max)
    };
    let corrected = change(&bowl, false).max(change(&mirrored, false));
    let release = change(&bowl, true).max(change(&mirrored, true));
    assert!(corrected < 1e-3 && release > 0.5, "{corrected} {release}");
}

/// 7: no hypothesis from repeated or collinear points.
#[test]
fn triplets_are_of_three_different_points() {
    let points: Vec<[f32; 3]> =
        (0..6).map(|i| [(i % 3) as f32, (i / 3) as f32, 0.3 * (i * i) as f32]).collect();
    let n = points.len();
    // Every point prefers its partner.
    let mut similarity = vec![0.0f32; (n + 1) * (n + 1)];
    (1..=n).for_each(|i| similarity[i * (n + 2)] = 1.0);
    let assignment = match_assignment(&similarity, &vec![1.0; n], &vec![1.0; n]);
    let config = HypothesisConfig { proposals: 500, kept: 500, ..HypothesisConfig::default() };
    let repeated = |allowed: bool| {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let coarse = coarse_pose(&assignment, &points, &points, &config, || rng.random(), allowed);
        let repeats = |side: [u32; 3]| side[0] == side[1] || side[1] == side[2] || side[0] == side[2];
        let hits = coarse
            .hypotheses
            .iter()
            .filter(|h| repeats(h.pairs.map(|p| p.0)) || repeats(h.pairs.map(|p| p.1)));
        hits.count()
    };
    assert_eq!(repeated(false), 0);
    assert!(repeated(true) > 200, "{}", repeated(true));
}

/// 10: another image, and the nearest of equivalent poses.
#[test]
fn references_come_from_other_images_and_labels_mind_symmetries() {
    let half_turn = Pose::new(Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)), Vector3::zeros());
    let figures = |quirk: bool| {
        let mut views = EllipsoidViews::new(4, 1);
        views.symmetries = ObjectSymmetries { discrete: vec![half_turn], continuous: vec![] };
        let model = model(|q| q.same_image_reference = quirk);
        let sampler = PairSampler::new(Arc::new(views), &DataConfig::default(), &model, 1).unwrap();
        let samples: Vec<_> = (0..40).map(|i| sampler.sample(i, false).unwrap()).collect();
        let same = samples.iter().filter(|s| s.key.query_image == s.key.reference_image).count();
        let angle = |pose: &Pose| pose.rotation_angle_deg(&Pose::identity());
        let apart = samples.iter().filter(|s| s.key.query_image != s.key.reference_image);
        // Where the half turn would make the rotation smaller.
        let t_object = EllipsoidViews::new(4, 1);
        let missed = apart.filter(|s| {
            let key = s.key;
            let query = t_object.pose(key.query_image, key.query_instance);
            let reference = t_object.pose(key.reference_image, key.reference_instance);
            angle(&(query * half_turn * reference.inverse())) + 1.0 < angle(&s.t_query_reference)
        });
        (same, missed.count())
    };
    assert_eq!(figures(false), (0, 0));
    let (same, missed) = figures(true);
    assert!(same >= 4 && missed >= 5, "{same} {missed}");
}

/// 11: padded neighbours do not count in the statistics.
#[test]
fn batch_statistics_are_those_of_the_true_neighbours() {
    // Two points near each other and one apart: 2, 2 and 1 neighbours in lists of 4.
    let points = [[0.0, 0.0, 0.0], [0.1, 0.05, 0.0], [3.0, 0.0, 0.0]];
    let groups = || ball_groups(&points, 0.5, 4, None);
    let mean = |counts_padding: bool| {
        let device = Device::flex().autodiff();
        let matching = MatchingConfig { hidden_dim: 8, ..MatchingConfig::default() };
        let fine = FineConfig { matching, pe_channels: [4, 4, 4], use_lrf: false, ..FineConfig::default() };
        let encoding = PositionalEncoding::new(&fine, &mut Initializer::new(4, &device));
        let config = ModelConfig { fine, ..model(|q| q.batchnorm_counts_padding = counts_padding) };
        let pair = [groups(), groups()];
        encoding.forward(&group_tensors(&[&pair], &config, &Device::flex()));
        let layer = &encoding.mlp1.layer0;
        let got = layer.normlayer.bn.running_mean.value_sync().inner().try_into_vec_as::<f32>().unwrap();
        (got, layer.conv.weight.val().inner())
    };
    let groups = groups();
    assert_eq!(groups.counts, [2, 2, 1]);
    // Mean of the rows that count, through the layer's weights, times the momentum 0.1.
    let by_hand = |padding: bool, weight: &Tensor<2>| {
        let rows: Vec<&[f32]> = (groups.features.chunks_exact(12).zip(&groups.counts))
            .flat_map(|(list, &count)| list.chunks_exact(3).take(if padding { 4 } else { count as usize }))
            .collect();
        let sum = |axis: usize| rows.iter().map(|r| r[axis]).sum::<f32>() / rows.len() as f32;
        let mean = TensorData::new((0..3).map(sum).collect::<Vec<_>>(), [1, 3]);
        let mean = Tensor::<2>::from_data(mean, &Device::flex());
        (mean.matmul(weight.clone()) * 0.1).try_into_vec_as::<f32>().unwrap()
    };
    let mut apart = 0.0f32;
    for padding in [false, true] {
        let (got, weight) = mean(padding);
        for (g, e) in got.iter().zip(by_hand(padding, &weight)) {
            assert!((g - e).abs() < 1e-6, "padding {padding}: {g} {e}");
        }
        let other = by_hand(!padding, &weight);
        apart = got.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(apart, f32::max);
    }
    assert!(apart > 1e-4, "{apart}");
}

/// 12: the axes of a local frame do not depend on which neighbour is found first.
#[test]
fn local_coordinates_do_not_depend_on_the_order_of_points() {
    let surface = |i: usize| {
        let (x, y) = ((i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1);
        [x, y + 0.03 * (5.0 * x).sin(), 0.2 * (3.0 * x + 1.0).sin() * (2.0 * y).cos()]
    };
    let points: Vec<[f32; 3]> = (0..400).map(surface).collect();
    let reversed: Vec<[f32; 3]> = points.iter().rev().copied().collect();
    let median_difference = |counts_padding: bool| {
        let fine = FineConfig { pe_radii: [0.15, 0.25], pe_samples: [32, 32], ..FineConfig::default() };
        let config = ModelConfig { fine, ..model(|q| q.local_frames_count_padding = counts_padding) };
        let [lists, turned] = [&points, &reversed].map(|p| positional_groups(p, &config));
        [0, 1].map(|ball| {
            let mut differences = Vec::new();
            for (i, &count) in lists[ball].counts.iter().enumerate() {
                assert!(count < 32);
                let entry = |groups: &BallGroups, point: usize, k: usize| {
                    let start = (point * 32 + k) * 6;
                    groups.features[start + 3..start + 6].to_vec()
                };
                for k in 0..count as usize {
                    let a = entry(&lists[ball], i, k);
                    let b = entry(&turned[ball], points.len() - 1 - i, count as usize - 1 - k);
                    differences.push(a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max));
                }
            }
            differences.sort_by(f32::total_cmp);
            differences[differences.len() / 2]
        })
    };
    assert!(median_difference(false).into_iter().all(|d| d < 1e-3), "{:?}", median_difference(false));
    assert!(median_difference(true).into_iter().all(|d| d > 0.05), "{:?}", median_difference(true));
}

/// The checked-in configurations name the behaviours of their networks.
#[test]
fn the_release_has_every_quirk_and_the_small_network_none() {
    let quirks = |name: &str| {
        let value = toml::Value::try_from(Config::embedded(name, &[]).unwrap().model.quirks).unwrap();
        let table = value.as_table().unwrap().clone();
        (table.len(), table.values().filter(|v| v.as_bool() == Some(true)).count())
    };
    assert_eq!(quirks("unopose"), (12, 12));
    assert_eq!(quirks("geo"), (12, 0));
}
