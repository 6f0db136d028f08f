//! Networks with and without the paper's ingredients.

use std::{io::Write as _, path::Path};

use unopose_core::files::write_atomic;
use unopose_eval::metrics::{Evaluation, paired_difference};

use super::{
    BenchError, Switches,
    cells::{percent, span},
    comparison::Comparison,
    published::published_ablation,
    run::MethodRun,
    section::Section,
};

/// Names of the network's ingredients as columns of an ablation: global reference frame, local reference frames, fine
/// stage, overlap prediction.
pub const INGREDIENTS: [&str; 4] = ["grf", "lrf", "fine", "overlap"];

/// Writes `ablation.md`: the networks with the named ingredients as columns, differences to the network that has most of
/// them, and the paper's rows beside them.
pub(crate) fn write_ablation(
    comparison: &Comparison,
    runs: &[(MethodRun, Evaluation)],
    switches: &[Option<Switches>],
    ingredients: &[String],
    folder: &Path,
) -> Result<(), BenchError> {
    let text = markdown(comparison, runs, switches, ingredients)?;
    Ok(write_atomic(&folder.join("ablation.md"), |out| out.write_all(text.as_bytes()))?)
}

fn markdown(
    comparison: &Comparison,
    runs: &[(MethodRun, Evaluation)],
    switches: &[Option<Switches>],
    ingredients: &[String],
) -> Result<String, BenchError> {
    if let Some(unknown) = ingredients.iter().find(|name| !INGREDIENTS.contains(&name.as_str())) {
        return Err(BenchError::Ingredient { name: unknown.clone(), expected: INGREDIENTS.join(", ") });
    }
    let networks: Vec<(usize, Switches)> =
        switches.iter().enumerate().filter_map(|(i, s)| Some((i, (*s)?))).collect();
    let has =
        |switches: &Switches| -> Vec<bool> { ingredients.iter().map(|name| switches.has(name)).collect() };
    let richness = |switches: &Switches| has(switches).iter().filter(|&&has| has).count();
    // The first of equals.
    let full = networks.iter().rev().max_by_key(|(_, switches)| richness(switches));
    let Some(&(full, _)) = full else { return Err(BenchError::NoNetwork) };
    let row = |name: &str, switches: &Switches, values: &[String]| -> Vec<String> {
        let marks = has(switches).into_iter().map(|has| if has { "yes" } else { "no" }.to_owned());
        std::iter::once(name.to_owned()).chain(marks).chain(values.iter().cloned()).collect()
    };
    let ours = networks.iter().map(|(index, switches)| {
        let (method, targets) = (&comparison.methods[*index], &runs[*index].1.targets);
        let difference =
            paired_difference(targets, &runs[full].1.targets, comparison.resamples, comparison.seed);
        let r = &method.scores.recall;
        let values = [
            percent(r.ar),
            span(&method.ar),
            percent(r.ar_vsd),
            percent(r.ar_mssd),
            percent(r.ar_mspd),
            percent(difference.value),
            span(&difference),
        ];
        row(&method.name, switches, &values)
    });
    let columns = |first: &str, scores: &[&str]| -> Vec<String> {
        let scores = scores.iter().map(|&score| score.to_owned());
        std::iter::once(first.to_owned()).chain(ingredients.iter().cloned()).chain(scores).collect()
    };
    let difference = format!("difference to {}", runs[full].0.name);
    let scores = ["AR", "95 % interval", "VSD", "MSSD", "MSPD", &difference, "95 % interval"];
    let ours = Section::table(columns("network", &scores), ours);
    let published = published_ablation(&comparison.dataset);
    let theirs = (!published.is_empty()).then(|| {
        let rows = published.iter().map(|published| {
            let [vsd, mssd, mspd, ar] = published.scores.map(|score| format!("{score:.1}"));
            row(published.row, &published.switches, &[ar, vsd, mssd, mspd])
        });
        Section::table(columns("row", &["AR", "VSD", "MSSD", "MSPD"]), rows)
            .titled("Published (tables \"Ablation of GRF and LRF\" and \"of overlap predictor\"):")
    });
    let heading = format!("Ablation on {} ({} targets)", comparison.dataset, comparison.targets);
    Ok(Section::markdown(&heading, std::iter::once(ours).chain(theirs)))
}

impl Switches {
    fn has(&self, ingredient: &str) -> bool {
        match ingredient {
            "grf" => self.grf,
            "lrf" => self.lrf,
            "fine" => self.fine,
            _ => self.overlap,
        }
    }
}
