//! The two forms of the overlap-aware assignment, from the same weights: the paper's computed by hand from the release's
//! similarities and overlap scores, in both stages.

use burn::tensor::{Device, Int, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::config::{Config, ModelConfig, OverlapMode};
use unopose_infer::host_assignments;
use unopose_nn::model::{
    BlockOutput, CoarsePointMatching, EncodedCloud, FinePointMatching, Initializer, SelfAttended, SparseRows,
    Supervision,
};

/// Sparse and dense points of the query and of the reference.
const SPARSE: [usize; 2] = [5, 4];
const DENSE: [usize; 2] = [9, 7];

fn random<const D: usize>(seed: u64, shape: [usize; D]) -> Tensor<D> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| rng.random_range(-1.0..1.0)).collect();
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn coarse(config: &ModelConfig) -> BlockOutput {
    let [query, reference] = clouds(config);
    coarse_stage(config).forward(&query, &reference, Supervision::LastBlock).remove(0)
}

fn fine(config: &ModelConfig) -> BlockOutput {
    let [query, reference] = clouds(config);
    fine_stage(config).forward(&query, &reference, Supervision::LastBlock).remove(0)
}

fn coarse_stage(config: &ModelConfig) -> CoarsePointMatching {
    CoarsePointMatching::new(config, &mut Initializer::new(3, &Device::flex()))
}

fn fine_stage(config: &ModelConfig) -> FinePointMatching {
    FinePointMatching::new(config, &mut Initializer::new(4, &Device::flex()))
}

fn clouds(config: &ModelConfig) -> [EncodedCloud; 2] {
    let width = config.geo_embedding.hidden_dim;
    let rows = |count: usize| {
        let rows = TensorData::new((0..count as i32).collect::<Vec<_>>(), [count]);
        Tensor::<1, Int>::from_data(rows, &Device::flex())
    };
    [0, 1].map(|k| EncodedCloud {
        position: Some(random(40 + k as u64, [1, DENSE[k], width])),
        ..EncodedCloud::new(
            random(30 + k as u64, [1, DENSE[k], config.color.out_dim()]),
            random(20 + k as u64, [1, SPARSE[k] + 1, SPARSE[k] + 1, width]),
            SparseRows { points: rows(SPARSE[k]), tokens: rows(SPARSE[k] + 1) },
        )
    })
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.try_into_vec_as::<f32>().unwrap().into_iter().map(f64::from).collect()
}

/// `softmax[(O_Q * F_Q) (O_P * F_P)^T]` row by row, from cosines `F_Q F_P^T` and raw overlap scores, background first.
fn by_hand(cosines: &[f64], query: &[f64], reference: &[f64]) -> Vec<f64> {
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let rows = cosines.chunks(reference.len()).zip(query).map(|(row, &q)| {
        let exp: Vec<f64> =
            row.iter().zip(reference).map(|(s, &p)| (sigmoid(q) * sigmoid(p) * s).exp()).collect();
        let sum: f64 = exp.iter().sum();
        exp.into_iter().map(move |e| e / sum)
    });
    rows.flatten().collect()
}

#[test]
fn the_paper_has_one_softmax_over_overlap_weighted_features() {
    let release = Config::embedded("smoke", &[]).unwrap().model;
    let paper = ModelConfig { overlap: OverlapMode::Paper, ..release.clone() };
    let stages = [("coarse", coarse(&release), coarse(&paper)), ("fine", fine(&release), fine(&paper))];
    for (stage, theirs, ours) in stages {
        // The same weights: the raw scores of the points agree, and only the paper's form needs the background's.
        let scores: Vec<Vec<f64>> = (0..2)
            .map(|k| {
                let points = values(ours.overlap.clone().unwrap()[k].clone());
                assert_eq!(points, values(theirs.overlap.clone().unwrap()[k].clone()));
                [values(ours.background_overlap.clone().unwrap()[k].clone()), points].concat()
            })
            .collect();
        assert!(theirs.background_overlap.is_none());

        let cosines = values(theirs.similarity.clone());
        let expected = by_hand(&cosines, &scores[0], &scores[1]);
        let got = &host_assignments(ours.clone(), OverlapMode::Paper, false).unwrap()[0].assignment;
        assert_eq!(got.weights.len(), expected.len());
        for (i, (&w, &e)) in got.weights.iter().zip(&expected).enumerate() {
            assert!((w as f64 - e).abs() < 2e-6, "{stage} entry {i}: {w}, by hand {e}");
        }
        for row in got.weights.chunks(got.columns) {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        }
        // Labels are the largest entries of a row and of a column.
        for (i, &label) in got.label_query.iter().enumerate() {
            let row = &got.weights[(i + 1) * got.columns..(i + 2) * got.columns];
            assert!(row.iter().all(|&w| w <= row[label as usize]));
        }
        for (j, &label) in got.label_reference.iter().enumerate() {
            let entry = |i: usize| got.weights[i * got.columns + j + 1];
            assert!((0..got.rows).all(|i| entry(i) <= entry(label as usize)));
        }

        let release = &host_assignments(theirs.clone(), OverlapMode::Release, false).unwrap()[0].assignment;
        let apart = got.weights.iter().zip(&release.weights).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart > 0.05, "{stage}: the two forms differ by {apart} only");
    }
}

#[test]
fn self_attention_computed_ahead_changes_nothing() {
    let config = Config::embedded("smoke", &[]).unwrap().model;
    let [query, reference] = clouds(&config);
    let coarse_ahead = Some(coarse_stage(&config).self_attention(&reference));
    let fine_ahead = fine_stage(&config).self_attention(&reference);
    assert!(fine_ahead.is_some());
    let kept =
        EncodedCloud { attended: SelfAttended { coarse: coarse_ahead, fine: fine_ahead }, ..reference };
    let again = coarse_stage(&config).forward(&query, &kept, Supervision::LastBlock).remove(0);
    assert_eq!(values(again.similarity), values(coarse(&config).similarity));
    let again = fine_stage(&config).forward(&query, &kept, Supervision::LastBlock).remove(0);
    assert_eq!(values(again.similarity), values(fine(&config).similarity));
}

#[test]
fn rows_of_a_batch_begin_where_their_cloud_does() {
    let config = Config::embedded("smoke", &[]).unwrap().model;
    let [one, _] = clouds(&config);
    let two = EncodedCloud::batch(&[&one, &one]).unwrap();
    assert_eq!(two.dense.dims()[0], 2);
    let rows = |tensor: Tensor<1, Int>| tensor.try_into_vec_as::<i64>().unwrap();
    assert_eq!(rows(two.rows.points.clone()), [0, 1, 2, 3, 4, 9, 10, 11, 12, 13]);
    assert_eq!(rows(two.rows.tokens.clone()), [0, 1, 2, 3, 4, 5, 10, 11, 12, 13, 14, 15]);
    // Each of the two is matched as it is alone.
    let alone = coarse_stage(&config).forward(&one, &one, Supervision::LastBlock).remove(0);
    let both = coarse_stage(&config).forward(&two, &two, Supervision::LastBlock).remove(0);
    let (alone, both) = (values(alone.similarity), values(both.similarity));
    assert!(both.iter().zip(alone.iter().cycle()).all(|(a, b)| (a - b).abs() < 1e-5));
}
