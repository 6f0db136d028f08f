//! Networks with and without the paper's ingredients.

use std::{fmt::Write as _, io::Write as _, path::Path};

use unopose_core::files::write_atomic;
use unopose_eval::eval::{Evaluation, paired_difference};

use super::{
    BenchError, Comparison, MethodRun, Switches,
    published::published_ablation,
    tables::{percent, span},
};

/// Names of the ingredients.
pub const INGREDIENTS: [&str; 4] = ["grf", "lrf", "fine", "overlap"];

/// Writes `ablation.md`: the networks with the named ingredients as columns, differences to the network that has most of
/// them, and the paper's rows beside them.
pub fn write_ablation(
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
    let marks =
        |switches: &Switches| -> Vec<bool> { ingredients.iter().map(|name| switches.has(name)).collect() };
    let richness = |switches: &Switches| marks(switches).iter().filter(|&&has| has).count();
    // The first of equals.
    let full = networks.iter().rev().max_by_key(|(_, switches)| richness(switches));
    let Some(&(full, _)) = full else { return Err(BenchError::NoNetwork) };
    let row = |name: &str, marks: &[bool], values: &[String]| {
        let marks: Vec<&str> = marks.iter().map(|&has| if has { "yes" } else { "no" }).collect();
        format!("| {name} | {} | {} |\n", marks.join(" | "), values.join(" | "))
    };
    let mut text = format!("# Ablation on {} ({} targets)\n\n", comparison.dataset, comparison.targets);
    let _ = writeln!(
        text,
        "| network | {} | AR | 95 % interval | VSD | MSSD | MSPD | difference to {} | 95 % interval |\n{}",
        ingredients.join(" | "),
        runs[full].0.name,
        "|--".repeat(8 + ingredients.len()) + "|"
    );
    for (index, switches) in &networks {
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
        text += &row(&method.name, &marks(switches), &values);
    }
    let published = published_ablation(&comparison.dataset);
    if !published.is_empty() {
        let _ = writeln!(
            text,
            "\nPublished (tables \"Ablation of GRF and LRF\" and \"of overlap predictor\"):\n\n\
             | row | {} | AR | VSD | MSSD | MSPD |\n{}",
            ingredients.join(" | "),
            "|--".repeat(5 + ingredients.len()) + "|"
        );
        for published in published {
            let [vsd, mssd, mspd, ar] = published.scores.map(|score| format!("{score:.1}"));
            text += &row(published.row, &marks(&published.switches), &[ar, vsd, mssd, mspd]);
        }
    }
    Ok(text)
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
