//! Is a dataset whole, and does it fit together? Any MegaPose or BOP folder, generated or not.
//!
//! [`check_dataset`] opens every part (shard or scene), decodes its images and compares what can be compared: counts,
//! members, masks with each other, visibility with masks, poses with masks and depth by drawing the models, units,
//! index files and target lists with what is there. It collects statistics of the images on the way.

mod image;
mod lists;
mod models;
mod report;
mod scenes;
mod shards;
mod statistics;

pub use report::{CheckReport, Finding, PartReport};
pub use statistics::{Histogram, Statistics};

use std::path::Path;

use unopose_dataset::formats::{BopDataset, megapose::ShardFile};

use super::{SynthError, folder};

/// Reads the set in `dir`. Of every part each `step`-th image is decoded; the others are only counted. `progress` is
/// called with the parts finished and their number.
pub fn check_dataset(
    dir: &Path,
    step: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<CheckReport, SynthError> {
    let dataset = BopDataset::open(dir)?;
    let (folder, shards) = ShardFile::list(dir);
    let step = step.max(1);
    // A folder of scenes looks like one of unpacked shards, but for the files inside.
    let splits = dataset.splits()?;
    let mut report = if !splits.is_empty() {
        scenes::check(&dataset, &splits, step, progress)?
    } else if !shards.is_empty() {
        shards::check(dir, &folder, &shards, step, progress)?
    } else {
        return Err(SynthError::NoDataset { folder: dir.to_owned() });
    };
    report.set.add(left_behind(dir)?);
    Ok(report)
}

/// Files that killed runs left half written.
fn left_behind(root: &Path) -> Result<Vec<Finding>, SynthError> {
    let what = "left behind by a run that was killed; the same generation again removes it";
    Ok(folder::parts_of(root)?.iter().map(|path| Finding::new(path.display(), what)).collect())
}

#[cfg(test)]
mod tests;
