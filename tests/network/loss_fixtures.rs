//! The loss terms and their gradients on stored inputs against the official implementation's, at the unit tolerances.
//! `UNOPOSE_TEST_DEVICE` names the device.

use burn::tensor::Tensor;
use unopose_core::config::LossConfig;
use unopose_nn::{
    loss::{MatchLabels, info_nce, weighted_bce},
    model::PoseTensors,
};
use unopose_tests::tensor_fixture::Fixture;

#[test]
fn losses_and_their_gradients_match() {
    let f = Fixture::open("losses");
    let config = LossConfig::default();
    let pose =
        PoseTensors { rotation: f.tensor("gt_R"), translation: f.tensor::<2>("gt_t").unsqueeze_dim::<3>(1) };
    let labels = MatchLabels::new(
        f.tensor("p1"),
        f.tensor("p2"),
        &pose,
        config.match_distance,
        config.overlap_distance,
    );
    // The square root of the rounding of x^2 - 2 x y + y^2 near 0.
    f.check("dis_mat", labels.distances.clone(), 1e-4);
    f.check("gt_overlap", labels.overlap.clone(), 0.0);
    for (name, label) in [("label1", &labels.query), ("label2", &labels.reference)] {
        assert_eq!(label.clone().try_into_vec_as::<i64>().unwrap(), f.file.int(name).1, "{name}");
    }

    // The stored scores are probabilities; ours are logits.
    let logits = |p: Tensor<2>| (p.clone() / (p.neg() + 1.0)).log().clamp(-200.0, 200.0);
    let tape = f.device.clone().autodiff();
    for case in ["normal", "saturated"] {
        let mut sum = Tensor::<1>::zeros([2], &f.device);
        for block in 0..3 {
            let name = |part: &str| format!("{case}.{part}{block}");
            let term = |part: &str| format!("{case}.per_sample.coarse_hard_{part}_loss{block}");
            for part in ["score", "saliency"] {
                let loss = weighted_bce(logits(f.tensor(&name(part))), labels.overlap.clone());
                f.check(&term(part), loss.clone(), if case == "normal" { 1e-5 } else { 1e-4 });
                sum = sum + loss * 2.0;
            }
            // The other case has similarities up to 108; cosines over the temperature end at 10, on which InfoNCE relies.
            if case == "saturated" {
                continue;
            }
            let similarity = f.tensor::<3>(&name("atten"));
            let loss = info_nce(&similarity, &labels, &config);
            f.check(&term("atten"), loss.clone(), 1e-5);
            sum = sum + loss * 2.0;
            // Two stages with the same inputs, mean over two pairs: one.
            let s = Tensor::<3>::from_data(similarity.into_data(), &tape).require_grad();
            let gradients = info_nce(&s, &labels, &config).sum().backward();
            f.check(&name("grad_atten"), s.grad(&gradients).unwrap(), 1e-6);
            let p = f.tensor::<2>(&name("score"));
            let x = Tensor::<2>::from_data(logits(p.clone()).into_data(), &tape).require_grad();
            let gradients = weighted_bce(x.clone(), labels.overlap.clone()).sum().backward();
            let by_probability = x.grad(&gradients).unwrap() / (p.clone() * (p.neg() + 1.0));
            f.check(&name("grad_score"), by_probability, 1e-6);
        }
        if case == "normal" {
            f.check("normal.loss_total", sum.clamp_max(config.clamp).mean(), 1e-4);
        }
    }
}
