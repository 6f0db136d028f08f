//! What a check found.

use std::fmt::Display;

use super::statistics::Statistics;

/// Something wrong in a data set.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Finding {
    /// File, image or instance.
    pub place: String,
    /// What is wrong there, in words.
    pub what: String,
}

impl Finding {
    pub(super) fn new(place: impl Display, what: impl Display) -> Self {
        Self { place: place.to_string(), what: what.to_string() }
    }
}

/// Findings of a part beyond this many are only counted.
const KEPT: usize = 100;

/// What a check found in one shard or scene.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct PartReport {
    /// Path of the shard or scene; `set` for what concerns the whole set.
    pub name: String,
    /// Size of a shard file, bytes; 0 for folders.
    pub bytes: u64,
    /// Images in the shard or scene.
    pub images: usize,
    /// Images that were decoded.
    pub decoded: usize,
    /// Instances in the decoded images.
    pub instances: usize,
    /// The first 100.
    pub findings: Vec<Finding>,
    /// Findings in all, those beyond the first 100 included.
    pub finding_count: usize,
    /// Inverted visible masks in the decoded images of a shard; readers mend them.
    pub mended_masks: usize,
    /// Instances in the decoded images of a shard that readers skip.
    pub skipped_instances: usize,
    /// Distributions over the decoded images.
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

/// What a check found in a data set.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct CheckReport {
    /// The shards or scenes, in order.
    pub parts: Vec<PartReport>,
    /// What concerns the set as a whole: index files, target lists, models.
    pub set: PartReport,
}

impl CheckReport {
    /// Findings in all, those that are only counted included.
    pub fn finding_count(&self) -> usize {
        self.parts.iter().map(|p| p.finding_count).sum::<usize>() + self.set.finding_count
    }

    /// The findings that were kept, those of the whole set first.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.set.findings.iter().chain(self.parts.iter().flat_map(|p| &p.findings))
    }

    /// Inverted visible masks that readers mend, in all parts.
    pub fn mended_masks(&self) -> usize {
        self.parts.iter().map(|p| p.mended_masks).sum()
    }

    /// Instances that readers skip, in all parts.
    pub fn skipped_instances(&self) -> usize {
        self.parts.iter().map(|p| p.skipped_instances).sum()
    }

    /// Images in all parts, decoded or not.
    pub fn images(&self) -> usize {
        self.parts.iter().map(|p| p.images).sum()
    }

    /// Distributions over the decoded images of all parts.
    pub fn statistics(&self) -> Statistics {
        let mut all = Statistics::default();
        self.parts.iter().for_each(|p| all.merge(&p.statistics));
        all
    }
}
