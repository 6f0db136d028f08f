//! What a check found.

use std::fmt::Display;

use super::statistics::Statistics;

/// Something wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// File, image or instance.
    pub place: String,
    pub what: String,
}

impl Finding {
    pub(super) fn new(place: impl Display, what: impl Display) -> Self {
        Self { place: place.to_string(), what: what.to_string() }
    }
}

/// Findings of a part beyond this many are only counted.
const KEPT: usize = 100;

/// One shard or scene.
#[derive(Clone, Debug, Default)]
pub struct PartReport {
    pub name: String,
    /// Size of a shard file; 0 for folders.
    pub bytes: u64,
    pub images: usize,
    /// Images that were decoded.
    pub decoded: usize,
    /// Instances in the decoded images.
    pub instances: usize,
    /// The first ones.
    pub findings: Vec<Finding>,
    /// How many there are.
    pub finding_count: usize,
    pub statistics: Statistics,
}

impl PartReport {
    pub(super) fn new(name: impl Display) -> Self {
        Self { name: name.to_string(), ..Self::default() }
    }

    pub(super) fn add(&mut self, findings: impl IntoIterator<Item = Finding>) {
        for finding in findings {
            self.finding_count += 1;
            if self.findings.len() < KEPT {
                self.findings.push(finding);
            }
        }
    }
}

/// A checked set.
#[derive(Clone, Debug, Default)]
pub struct CheckReport {
    pub parts: Vec<PartReport>,
    /// Index files, target lists, models.
    pub set: PartReport,
}

impl CheckReport {
    pub fn finding_count(&self) -> usize {
        self.parts.iter().map(|p| p.finding_count).sum::<usize>() + self.set.finding_count
    }

    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.set.findings.iter().chain(self.parts.iter().flat_map(|p| &p.findings))
    }

    pub fn images(&self) -> usize {
        self.parts.iter().map(|p| p.images).sum()
    }

    pub fn statistics(&self) -> Statistics {
        let mut all = Statistics::default();
        self.parts.iter().for_each(|p| all.merge(&p.statistics));
        all
    }
}
