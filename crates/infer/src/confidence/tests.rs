use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// Estimates whose outcome depends on fit and points by a known law; the overlap repeats the fit with noise, the rest is
/// noise alone.
fn observed(count: usize, seed: u64) -> Vec<(Evidence, bool)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let (fit, points) = (rng.random_range(0.0..1.0f64), rng.random_range(20.0..2000.0f64));
            let evidence = Evidence {
                fit,
                overlap_query: (fit + rng.random_range(-0.3..0.3)).clamp(0.0, 1.0),
                matched: rng.random(),
                mass: 0.5,
                residual: rng.random_range(0.05..0.1),
                rival: rng.random(),
                points: points as usize,
                ..Evidence::default()
            };
            let probability = 1.0 / (1.0 + (-(8.0 * (fit - 0.6) + 1.5 * (points / 300.0).ln())).exp());
            (evidence, rng.random::<f64>() < probability)
        })
        .collect()
}

fn fitted() -> Calibration {
    Calibration::fit(&observed(4000, 1), PoseCriterion::DEFAULT, "a law").unwrap()
}

#[test]
fn the_law_is_found_and_predicts_other_pairs() {
    let calibration = fitted();
    let weight = |feature| calibration.terms.iter().find(|t| t.feature == feature).unwrap().weight;
    assert!((weight(Feature::Fit) - 8.0).abs() < 1.2, "{calibration:?}");
    assert!((weight(Feature::Points) - 1.5).abs() < 0.2, "{calibration:?}");
    assert!(calibration.terms.iter().all(|term| term.weight >= 0.0));
    let held_out = observed(4000, 2);
    for from in [0.1, 0.3, 0.5, 0.7] {
        let inside: Vec<(f64, bool)> = held_out
            .iter()
            .map(|(e, right)| (calibration.probability(e), *right))
            .filter(|(p, _)| (from..from + 0.2).contains(p))
            .collect();
        let predicted = inside.iter().map(|(p, _)| p).sum::<f64>() / inside.len() as f64;
        let found = inside.iter().filter(|(_, right)| *right).count() as f64 / inside.len() as f64;
        assert!((predicted - found).abs() < 0.06, "{predicted} predicted, {found} found");
    }
    let above: Vec<bool> = held_out
        .iter()
        .filter(|(e, _)| calibration.probability(e) >= calibration.threshold)
        .map(|(_, right)| *right)
        .collect();
    let precision = above.iter().filter(|&&right| right).count() as f64 / above.len() as f64;
    assert!((precision - 0.9).abs() < 0.03, "{precision} at {}", calibration.threshold);
}

#[test]
fn doubts_name_what_is_unusual() {
    let calibration = fitted();
    let good = Evidence {
        fit: 0.95,
        overlap_query: 0.95,
        matched: 0.5,
        mass: 0.5,
        points: 1500,
        residual: 0.07,
        ..Evidence::default()
    };
    let confident = calibration.judge(&good, calibration.threshold);
    assert!(confident.confident && confident.reasons.is_empty(), "{confident:?}");
    let few = calibration.judge(&Evidence { points: 25, fit: 0.6, ..good }, calibration.threshold);
    assert!(!few.confident);
    assert_eq!(few.reasons[0].kind, ReasonKind::FewPoints, "{few:?}");
    assert!(few.reasons[0].text.contains("25 pixels"), "{few:?}");
    let loose = calibration.judge(&Evidence { fit: 0.1, ..good }, calibration.threshold);
    assert_eq!(loose.reasons[0].kind, ReasonKind::PoorFit, "{loose:?}");
    // Even where nothing is unusual a doubted pose has a reason.
    assert_eq!(calibration.judge(&good, 1.1).reasons.len(), 1);
}

#[test]
fn it_travels_in_metadata() {
    let calibration = fitted();
    let path = std::path::Path::new("weights.safetensors");
    let metadata = [calibration.to_metadata()].into();
    assert_eq!(Calibration::from_metadata(&metadata, path).unwrap(), Some(calibration));
    assert_eq!(Calibration::from_metadata(&Default::default(), path).unwrap(), None);
    let broken = [("calibration".to_owned(), "{\"intercept\": 1}".to_owned())].into();
    let message = Calibration::from_metadata(&broken, path).unwrap_err().to_string();
    assert!(message.contains("weights.safetensors") && message.contains("calibration"), "{message}");
}

#[test]
fn too_few_outcomes_of_one_kind_give_none() {
    let right: Vec<(Evidence, bool)> = observed(200, 3).into_iter().map(|(e, _)| (e, true)).collect();
    assert!(Calibration::fit(&right, PoseCriterion::DEFAULT, "").is_none());
    assert!(Calibration::fit(&[], PoseCriterion::DEFAULT, "").is_none());
}

#[test]
fn a_doubt_from_outside_takes_the_trust_and_comes_first() {
    let calibration = fitted();
    let sure = observed(4000, 3).into_iter().map(|(evidence, _)| calibration.judge(&evidence, 0.1));
    let mut confidence = sure.max_by(|a, b| a.probability.total_cmp(&b.probability)).unwrap();
    assert!(confidence.confident && confidence.reasons.is_empty());
    let probability = confidence.probability;
    confidence.doubt(ReasonKind::DoubtfulUnit, "9 m away".into());
    assert_eq!((confidence.confident, confidence.probability), (false, probability));
    assert_eq!(serde_json::to_value(&confidence.reasons).unwrap()[0]["kind"], "doubtful_unit");
}
