//! Tables of networks with and without the paper's ingredients.

use std::sync::atomic::AtomicUsize;

use unopose_core::frame::MaskedView;
use unopose_pairs::registration::{PairEstimator, PairPose, Refinement, RegistrationError};

use super::{super::*, Shift, write_dataset};

#[test]
fn ablations_compare_networks_beside_the_papers() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_dataset(folder.path());
    let shift = |name: &'static str, grf: bool| Method {
        estimator: Box::new(Named { name, shift: Shift { asked: AtomicUsize::new(0) } }),
        switches: Some(Switches { grf, lrf: true, fine: true, overlap: true }),
    };
    let out = folder.path().join("out");
    let suite = |ablation: &[String]| {
        let methods = [shift("without-grf", false), shift("full", true)];
        let suite = Suite {
            methods: &methods,
            refinements: &[Refinement::None],
            ablation,
            cache: &folder.path().join("results"),
            score_targets: None,
            seed: 1,
            progress: &|_, _, _| {},
        };
        suite.run(&list, &ListFacts::default(), &out)
    };
    suite(&["grf".into(), "overlap".into()]).unwrap();
    let text = std::fs::read_to_string(out.join("ablation.md")).unwrap();
    assert!(text.contains("| without-grf | no | yes | 50.0 |"), "{text}");
    assert!(text.contains("difference to full") && text.contains("| C1 | yes | yes | 83.1 |"), "{text}");
    let message = suite(&["colour".into()]).unwrap_err().to_string();
    assert!(message.contains("\"colour\", expected some of grf, lrf, fine, overlap"), "{message}");
    let frames_off = Switches { grf: false, lrf: false, fine: true, overlap: false };
    assert_eq!(frames_off.name(), "sam6d-style");
}

/// [`Shift`] under another name.
struct Named {
    name: &'static str,
    shift: Shift,
}

impl PairEstimator for Named {
    fn name(&self) -> String {
        self.name.into()
    }

    fn fingerprint(&self) -> String {
        self.shift.fingerprint()
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        self.shift.estimate(query, reference)
    }
}
