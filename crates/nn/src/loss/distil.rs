//! What a colour encoder learns before poses: the features of a teacher, the similarities between them, and which points of
//! two views are the same (`docs/network.md`, section 12).

use burn::tensor::{Tensor, activation::log_softmax};
use unopose_core::config::DistilConfig;

use super::Losses;

/// Added to what is left out of a softmax.
const LEFT_OUT: f32 = -1e4;
/// Points nearer than this many match distances to a point's match are no wrong matches.
const UNDECIDED: f32 = 2.0;
const LEAST_LENGTH: f32 = 1e-6;

/// Features of the same points of a batch of pairs, query and reference.
pub struct FeaturePair {
    /// The encoder's, `[B, N, C_color]`.
    pub features: [Tensor<3>; 2],
    /// The encoder's, mapped to the teacher's channels, `[B, N, C]`.
    pub mapped: [Tensor<3>; 2],
    /// The teacher's, `[B, N, C]`, without gradient.
    pub teacher: [Tensor<3>; 2],
}

/// The terms `feature`, `structure` and `contrast` per pair and their weighted mean. `distances` `[B, N, N]` are those between
/// query (moved by the true pose) and reference points, radii; points at most `match_distance` apart match.
pub fn distil_losses(
    config: &DistilConfig,
    pairs: &FeaturePair,
    distances: &Tensor<3>,
    match_distance: f32,
) -> Losses {
    let terms = [
        ("feature", config.feature_weight, feature(pairs)),
        ("structure", config.structure_weight, structure(&pairs.features, &pairs.teacher)),
        ("contrast", config.contrast_weight, contrast(config, pairs, distances, match_distance)),
    ];
    let total = terms.iter().map(|(_, weight, value)| value.clone().mul_scalar(*weight));
    let total =
        total.reduce(|a, b| a + b).map_or_else(|| Tensor::zeros([1], &distances.device()), Tensor::mean);
    Losses { total, terms: terms.into_iter().map(|(name, _, value)| (name.to_owned(), value)).collect() }
}

/// One minus the cosine between mapped and teacher's features, mean over the points: `[B]`.
fn feature(pairs: &FeaturePair) -> Tensor<1> {
    let [query, reference] = [0, 1].map(|view| {
        let cosines = (unit(pairs.mapped[view].clone()) * unit(pairs.teacher[view].clone())).sum_dim(2);
        per_pair(1.0 - cosines)
    });
    (query + reference) / 2.0
}

/// Mean squared difference between the cosines of all points of both views of a pair, `features` against `others`
/// (`[B, N, C]` each, of any channels): `[B]`. The batch's mean, which says nothing about a point, is subtracted first.
pub fn structure(features: &[Tensor<3>; 2], others: &[Tensor<3>; 2]) -> Tensor<1> {
    let cosines = |views: &[Tensor<3>; 2]| {
        let all = unit(centred(Tensor::cat(views.to_vec(), 1)));
        all.clone().matmul(all.swap_dims(1, 2))
    };
    per_pair((cosines(features) - cosines(others)).square())
}

/// InfoNCE in both directions: the nearest point of the other view under the true pose, where it is near enough, against
/// all points that are clearly others: `[B]`, 0 for a pair without a match.
fn contrast(
    config: &DistilConfig,
    pairs: &FeaturePair,
    distances: &Tensor<3>,
    match_distance: f32,
) -> Tensor<1> {
    let [query, reference] = pairs.features.clone().map(unit);
    let logits = query.matmul(reference.swap_dims(1, 2)).div_scalar(config.temperature);
    let one_way = |logits: Tensor<3>, distances: Tensor<3>| {
        let (nearest, index) = distances.clone().min_dim_with_indices(2);
        let right = logits.clone().gather(2, index);
        let undecided = distances.lower_scalar(UNDECIDED * match_distance);
        let wrong = logits.mask_fill(undecided, LEFT_OUT);
        let cross_entropy = log_softmax(Tensor::cat(vec![right, wrong], 2), 2).narrow(2, 0, 1).neg();
        let matched = nearest.lower_equal_scalar(match_distance).float();
        let count = per_pair(matched.clone()).clamp_min(LEAST_LENGTH);
        per_pair(cross_entropy * matched) / count
    };
    let backward = one_way(logits.clone().swap_dims(1, 2), distances.clone().swap_dims(1, 2));
    (one_way(logits, distances.clone()) + backward) / 2.0
}

/// Rows of unit length.
fn unit(features: Tensor<3>) -> Tensor<3> {
    let length = features.clone().square().sum_dim(2).add_scalar(LEAST_LENGTH.powi(2)).sqrt();
    features / length
}

/// Without the mean over batch and points.
fn centred(features: Tensor<3>) -> Tensor<3> {
    let mean = features.clone().mean_dim(0).mean_dim(1);
    features - mean
}

/// Mean over everything but the batch: `[B]`.
fn per_pair(values: Tensor<3>) -> Tensor<1> {
    let batch = values.dims()[0];
    values.mean_dim(1).mean_dim(2).reshape([batch])
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Distribution};

    use super::*;

    fn config() -> DistilConfig {
        DistilConfig {
            feature_weight: 1.0,
            structure_weight: 10.0,
            contrast_weight: 100.0,
            temperature: 0.5,
            ..DistilConfig::default()
        }
    }

    fn random(shape: [usize; 3]) -> Tensor<3> {
        Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), &Device::default())
    }

    fn terms(losses: &Losses) -> Vec<Vec<f32>> {
        losses.terms.iter().map(|(_, value)| value.clone().into_data().iter::<f32>().collect()).collect()
    }

    #[test]
    fn a_turned_copy_of_the_teacher_costs_nothing() {
        let teacher = [random([2, 6, 3]), random([2, 6, 3])];
        // A rotation of all features keeps their cosines; the mapped ones are longer only.
        let turn =
            Tensor::<2>::from_floats([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], &Device::default());
        let pairs = FeaturePair {
            features: teacher.clone().map(|t| t.matmul(turn.clone().unsqueeze())),
            mapped: teacher.clone().map(|t| t * 3.0),
            teacher,
        };
        let far = Tensor::<3>::full([2, 6, 6], 9.0, &Device::default());
        let losses = distil_losses(&config(), &pairs, &far, 0.1);
        for (values, (name, _)) in terms(&losses).iter().zip(&losses.terms) {
            assert!(values.iter().all(|v| v.abs() < 1e-6), "{name}: {values:?}");
        }
        // Features of the opposite sign have the same structure and the largest feature loss.
        let pairs = FeaturePair { mapped: pairs.teacher.clone().map(Tensor::neg), ..pairs };
        let losses = terms(&distil_losses(&config(), &pairs, &far, 0.1));
        assert!(losses[0].iter().all(|v| (v - 2.0).abs() < 1e-5) && losses[1][0] < 1e-6, "{losses:?}");
    }

    #[test]
    fn contrast_is_the_cross_entropy_of_the_nearest_point_among_the_clearly_other_ones() {
        let device = Device::default();
        let row = |values: [[f32; 2]; 3]| Tensor::<2>::from_floats(values, &device).unsqueeze::<3>();
        let features =
            [row([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]), row([[2.0, 0.0], [0.0, 1.0], [0.0, -4.0]])];
        // Query 0 matches reference 0 and is undecided about reference 1; query 1 matches 1; query 2 nothing.
        let distances =
            Tensor::<2>::from_floats([[0.05, 0.15, 1.0], [0.5, 0.1, 0.9], [2.0, 2.0, 2.0]], &device);
        let pairs = FeaturePair { mapped: features.clone(), teacher: features.clone(), features };
        let value = contrast(&config(), &pairs, &distances.unsqueeze(), 0.1).into_scalar::<f32>();
        // Cosines over 0.5. Forward: query 0: right 2, wrong 0 (reference 2). Query 1: right 2, wrong 0 and -2.
        let cross_entropy = |right: f64, wrong: &[f64]| {
            (right.exp() + wrong.iter().map(|w| w.exp()).sum::<f64>()).ln() - right
        };
        let forward = (cross_entropy(2.0, &[0.0]) + cross_entropy(2.0, &[0.0, -2.0])) / 2.0;
        // Backward: reference 0: right 2, wrong 0 and -2. Reference 1 (nearest query 1): wrong 0 (query 2).
        let backward = (cross_entropy(2.0, &[0.0, -2.0]) + cross_entropy(2.0, &[0.0])) / 2.0;
        let expected = (forward + backward) / 2.0;
        assert!((f64::from(value) - expected).abs() < 1e-5, "{value}, by hand {expected}");
    }

    #[test]
    fn every_term_has_a_gradient_and_the_total_is_their_weighted_sum() {
        let device = Device::default().autodiff();
        let leaf =
            |shape| Tensor::<3>::random(shape, Distribution::Uniform(-1.0, 1.0), &device).require_grad();
        let features = [leaf([2, 5, 4]), leaf([2, 5, 4])];
        let mapped = [leaf([2, 5, 6]), leaf([2, 5, 6])];
        let teacher = [random([2, 5, 6]), random([2, 5, 6])].map(Tensor::autodiff);
        let pairs = FeaturePair { features: features.clone(), mapped: mapped.clone(), teacher };
        let distances = (random([2, 5, 5]).abs() * 0.3).autodiff();
        let losses = distil_losses(&config(), &pairs, &distances, 0.1);
        let by_term = terms(&losses);
        let mean = |values: &[f32]| values.iter().sum::<f32>() / 2.0;
        let expected = mean(&by_term[0]) + 10.0 * mean(&by_term[1]) + 100.0 * mean(&by_term[2]);
        let total = losses.total.clone().into_scalar::<f32>();
        assert!((total - expected).abs() < 1e-3 * expected, "{total}, {expected}");
        let gradients = losses.total.backward();
        for tensor in features.iter().chain(&mapped) {
            let largest = tensor.grad(&gradients).unwrap().abs().max().into_scalar::<f32>();
            assert!(largest > 1e-4, "{largest}");
        }
    }
}
