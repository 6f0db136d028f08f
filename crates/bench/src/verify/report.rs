//! One row per stored tensor and what follows from them.

use std::fmt;

use super::{
    computed::Values,
    tensors::HostTensor,
    tolerance::{Tolerance, matches},
};

/// Tensors that need not be computed, with the reason.
const NOT_COMPUTED: [(&str, &str); 1] =
    [("buffer_after.*.num_batches_tracked", "the weights hold no such counter")];

/// Outcome for one tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Read by the network.
    Input,
    /// Within the tolerance.
    Ok,
    /// Beyond the tolerance, of another shape, or not finite.
    Over,
    /// Unknown to this program, or absent from this network.
    NotComputed,
}

/// Comparison of one tensor.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub name: String,
    /// As stored.
    pub shape: Vec<usize>,
    /// Largest absolute difference of the compared entries; NaN without a comparison.
    pub max_difference: f64,
    /// Mean absolute difference of the compared entries; NaN without a comparison.
    pub mean_difference: f64,
    /// `None` without a comparison.
    pub tolerance: Option<Tolerance>,
    pub verdict: Verdict,
    /// What a number does not say.
    pub note: String,
}

/// All rows of a file.
#[derive(Clone, Debug)]
pub struct Report {
    pub(super) rows: Vec<Row>,
}

impl Row {
    pub(super) fn without_numbers(name: &str, stored: &HostTensor, verdict: Verdict) -> Self {
        let reason = NOT_COMPUTED.iter().find(|(pattern, _)| matches(pattern, name));
        let note = match (verdict, reason) {
            (Verdict::NotComputed, Some((_, reason))) => (*reason).to_owned(),
            _ => String::new(),
        };
        Self {
            name: name.into(),
            shape: stored.shape.clone(),
            max_difference: f64::NAN,
            mean_difference: f64::NAN,
            tolerance: None,
            verdict,
            note,
        }
    }

    pub(super) fn compare(name: &str, stored: &HostTensor, computed: &Values, tolerance: Tolerance) -> Self {
        let mut row = Self::without_numbers(name, stored, Verdict::Over);
        row.tolerance = Some(tolerance);
        // A 1x1 convolution is a linear map here, and scalars are stored with one axis.
        let trimmed = |shape: &[usize]| {
            let ones = shape.iter().rev().take_while(|&&n| n == 1).count();
            shape[..shape.len() - ones].to_vec()
        };
        if trimmed(&stored.shape) != trimmed(&computed.shape) || stored.values.len() != computed.values.len()
        {
            row.note = format!("computed with shape {:?}", computed.shape);
            return row;
        }
        let counts = |i: usize| computed.compared.get(i).copied().unwrap_or(true);
        let pairs: Vec<(f64, f64)> = (0..stored.values.len())
            .filter(|&i| counts(i))
            .map(|i| (computed.values[i], stored.values[i]))
            .collect();
        let open = stored.values.len() - pairs.len();
        if open > 0 {
            row.note = format!("{open} undetermined entries not compared");
        }
        let differences = pairs.iter().map(|(a, b)| (a - b).abs());
        // Unlike f64::max this keeps NaN.
        let worst = |a: f64, b: f64| if b > a || b.is_nan() { b } else { a };
        row.max_difference = differences.clone().fold(0.0, |a, b| if a.is_nan() { a } else { worst(a, b) });
        row.mean_difference = differences.sum::<f64>() / pairs.len().max(1) as f64;
        let within = match tolerance {
            Tolerance::Absolute(bound) => row.max_difference <= bound,
            Tolerance::Direction { relative_l2, cosine } => {
                let norm =
                    |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(|p| f(p).powi(2)).sum::<f64>().sqrt();
                let (ours, theirs) = (norm(&|p| p.0), norm(&|p| p.1));
                let relative = norm(&|p| p.0 - p.1) / theirs;
                let product: f64 = pairs.iter().map(|(a, b)| a * b).sum();
                let angle = product / (ours * theirs);
                row.note = format!("relative L2 {relative:.1e}, cosine {angle:.6}");
                (relative <= relative_l2 && angle > cosine) || (ours == 0.0 && theirs == 0.0)
            }
        };
        row.verdict = if within { Verdict::Ok } else { Verdict::Over };
        row
    }

    /// Whether this row speaks against the network.
    pub(crate) fn fails(&self) -> bool {
        match self.verdict {
            Verdict::Input | Verdict::Ok => false,
            Verdict::Over => true,
            Verdict::NotComputed => !NOT_COMPUTED.iter().any(|(pattern, _)| matches(pattern, &self.name)),
        }
    }
}

impl Report {
    fn count(&self, verdict: Verdict) -> usize {
        self.rows.iter().filter(|row| row.verdict == verdict).count()
    }

    /// Nothing is over and nothing unexplained is missing.
    pub fn passes(&self) -> bool {
        !self.rows.iter().any(Row::fails)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Input => "input",
            Self::Ok => "ok",
            Self::Over => "over",
            Self::NotComputed => "not computed",
        })
    }
}

impl fmt::Display for Tolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absolute(0.0) => f.pad("equal"),
            Self::Absolute(bound) => f.pad(&format!("{bound:.1e}")),
            Self::Direction { relative_l2, .. } => f.pad(&format!("L2 {relative_l2:.0e}")),
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shape = |row: &Row| format!("{:?}", row.shape);
        let width = self.rows.iter().map(|row| row.name.len()).max().unwrap_or(4).max(4);
        let shapes = self.rows.iter().map(|row| shape(row).len()).max().unwrap_or(5).max(5);
        let line = |cells: [&str; 5]| {
            let [name, shape, max, mean, tolerance] = cells;
            format!("{name:<width$}  {shape:<shapes$}  {max:>8}  {mean:>8}  {tolerance:>8}")
        };
        writeln!(f, "{}  verdict", line(["tensor", "shape", "max", "mean", "limit"]))?;
        for row in &self.rows {
            let number = |value: f64| match row.verdict {
                Verdict::Input | Verdict::NotComputed => "-".to_owned(),
                _ => format!("{value:.1e}"),
            };
            let tolerance = row.tolerance.map_or("-".into(), |t| t.to_string());
            let (max, mean) = (number(row.max_difference), number(row.mean_difference));
            let note = if row.note.is_empty() { String::new() } else { format!("  ({})", row.note) };
            let cells = line([&row.name, &shape(row), &max, &mean, &tolerance]);
            writeln!(f, "{cells}  {}{note}", row.verdict)?;
        }
        write!(
            f,
            "{} tensors: {} input, {} ok, {} over, {} not computed",
            self.rows.len(),
            self.count(Verdict::Input),
            self.count(Verdict::Ok),
            self.count(Verdict::Over),
            self.count(Verdict::NotComputed)
        )
    }
}
