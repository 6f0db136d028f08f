//! All methods on a list, with everything that is written about them.

use std::{collections::BTreeSet, path::Path};

use unopose_dataset::protocol::TargetList;
use unopose_eval::metrics::{score_poses, write_poses};
use unopose_pairs::registration::{PairEstimator, Refined, Refinement};

use super::{
    BenchError, ListFacts, Switches, ablation::write_ablation, comparison::Comparison, examples::Examples,
    report::write_report, run::run_method,
};

/// An estimator that takes part.
pub struct Method {
    /// Estimates pairs; its name is the method's.
    pub estimator: Box<dyn PairEstimator>,
    /// A network's ingredients; `None` for other methods.
    pub switches: Option<Switches>,
}

/// Methods and what is common to their runs.
pub struct Suite<'a> {
    /// In the order of the tables' rows.
    pub methods: &'a [Method],
    /// Every method is run with each of them.
    pub refinements: &'a [Refinement],
    /// Ingredients of an ablation table over the networks; no table without any.
    pub ablation: &'a [String],
    /// Folder of the kept results.
    pub cache: &'a Path,
    /// Targets that recall counts; those of the list when `None`.
    pub score_targets: Option<&'a Path>,
    /// Seed of the resampling behind the intervals.
    pub seed: u64,
    /// Called with what is being done, the images done and all images.
    pub progress: &'a (dyn Fn(&str, usize, usize) + Sync),
}

impl Suite<'_> {
    /// Runs and scores every method with every refinement and writes poses, scores, tables and the page into `folder`.
    pub fn run(&self, list: &TargetList, facts: &ListFacts, folder: &Path) -> Result<(), BenchError> {
        let (mut runs, mut examples, mut switches) = (Vec::new(), Vec::new(), Vec::new());
        // What is wrong with the input is the same for all methods and told once.
        let mut told = BTreeSet::new();
        for method in self.methods {
            for &refinement in self.refinements {
                let refined = Refined { estimator: method.estimator.as_ref(), refinement };
                let name = refined.name();
                let estimating = format!("{name}: estimating");
                let show = &mut |done, total| (self.progress)(&estimating, done, total);
                let run = run_method(list, &refined, self.cache, show)?;
                tracing::debug!("{name}: {} pairs estimated, the others known", run.computed);
                write_poses(list, &run.poses, &name, &folder.join(&name))?;
                let scoring = format!("{name}: scoring");
                let show = |done, total| (self.progress)(&scoring, done, total);
                let evaluation = score_poses(list, &run.poses, self.score_targets, &show)?;
                evaluation.write(&folder.join(&name))?;
                for warning in &evaluation.scores.input.warnings {
                    if told.insert(warning.clone()) {
                        tracing::warn!("{name}: {warning}");
                    }
                }
                examples.push(Examples::draw(list, &run, &evaluation, folder)?);
                switches.push(method.switches);
                runs.push((run, evaluation));
            }
        }
        let comparison = Comparison::new(facts, list, &runs, self.seed);
        write_report(&comparison, &examples, folder)?;
        if !self.ablation.is_empty() {
            write_ablation(&comparison, &runs, &switches, self.ablation, folder)?;
        }
        Ok(())
    }
}
