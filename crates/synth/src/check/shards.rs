//! MegaPose sets: shards, their images, and whether all shards are there.

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use unopose_core::config::SynthConfig;
use unopose_dataset::formats::{
    FormatError,
    megapose::{InstanceFault, ShardFile},
};

use super::{
    image::ImageUnderCheck,
    lists::{self, KnownImage},
    models::Models,
    report::{CheckReport, Finding, PartReport},
    statistics::Statistics,
};
use crate::{SynthError, folder};

/// Checks every shard, decoding each `step`-th image.
pub(super) fn check(
    dir: &Path,
    folder: &Path,
    shards: &[(u32, PathBuf)],
    step: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<CheckReport, SynthError> {
    let above = folder.parent().unwrap_or(dir);
    let models = Models::find(&[dir, above])?;
    let mut report = CheckReport { set: PartReport::new("set"), ..CheckReport::default() };
    let mut known: HashMap<String, KnownImage> = HashMap::new();
    for (number, path) in shards {
        let part = match ShardFile::open(*number, path) {
            Ok(shard) => check_shard(&shard, path, step, &models, &mut known),
            Err(error) => {
                let mut part = PartReport::new(path.display());
                part.add([Finding::new(path.display(), error)]);
                part
            }
        };
        report.parts.push(part);
        progress(report.parts.len(), shards.len());
    }
    let numbers: BTreeSet<u32> = shards.iter().map(|s| s.0).collect();
    let config = folder::generated_by(above)?;
    report.set.add(missing_shards(folder, &numbers, config.as_ref()));
    report.set.add(short_shards(&report.parts, config.is_some()));
    report.set.add(lists::check_index_files(above, folder, &known, config.is_some())?);
    report.set.add(models.into_findings());
    Ok(report)
}

fn check_shard(
    shard: &ShardFile,
    path: &Path,
    step: usize,
    models: &Models,
    known: &mut HashMap<String, KnownImage>,
) -> PartReport {
    let mut part = PartReport::new(path.display());
    part.bytes = std::fs::metadata(path).map_or(0, |m| if m.is_file() { m.len() } else { 0 });
    part.add(shard.problems().iter().map(|problem| Finding::new("shard", problem)));
    let keys: Vec<&str> = shard.keys().collect();
    part.images = keys.len();
    if keys.is_empty() && shard.problems().is_empty() {
        part.add([Finding::new(path.display(), format!("no images in {} bytes", part.bytes))]);
    }
    let checked: Vec<Option<CheckedKey>> = keys
        .par_iter()
        .enumerate()
        .map(|(at, key)| at.is_multiple_of(step).then(|| check_key(shard, path, key, models)))
        .collect();
    for (key, checked) in keys.iter().zip(checked) {
        let mut image = KnownImage { shard: shard.number, instances: None };
        if let Some((instances, findings, statistics)) = checked {
            part.add(findings);
            match instances {
                Ok((count, faults)) => {
                    image.instances = Some(count);
                    let mended = faults.iter().filter(|(_, fault)| fault.is_mended()).count();
                    part.mended_masks += mended;
                    part.skipped_instances += faults.len() - mended;
                    let place = |i| format!("{}: {key}, instance {i}", path.display());
                    part.add(faults.iter().map(|(i, fault)| Finding::new(place(*i), fault)));
                    part.decoded += 1;
                    part.instances += count;
                }
                // The message names shard and member.
                Err(error) => part.add([Finding::new("image", error)]),
            }
            part.statistics.merge(&statistics);
        }
        if let Some(first) = known.insert((*key).to_owned(), image) {
            let place = format!("{}: {key}", path.display());
            part.add([Finding::new(place, format!("the same key is in shard {}", first.shard))]);
        }
    }
    part
}

/// Instances of an image and those that training mends or skips, or why it has none; what else is wrong with it; its
/// distributions.
type CheckedKey = (Result<(usize, Vec<(usize, InstanceFault)>), FormatError>, Vec<Finding>, Statistics);

fn check_key(shard: &ShardFile, path: &Path, key: &str, models: &Models) -> CheckedKey {
    let (mut statistics, place) = (Statistics::default(), format!("{}: {key}", path.display()));
    match shard.read(key, &models.infos) {
        Ok(image) => {
            let mut under_check = ImageUnderCheck {
                place,
                frame: &image.annotated.frame,
                gt: &image.records.gt,
                info: &image.records.gt_info,
                masks: image.masks,
                visible: image.annotated.instances.into_iter().map(|i| i.mask_visib).collect(),
                skipped: Vec::new(),
            };
            let skipped = image.faults.iter().filter(|(_, fault)| !fault.is_mended());
            under_check.skipped = skipped.map(|(i, _)| *i).collect();
            let findings = under_check.check(models, &mut statistics);
            (Ok((image.records.gt.len(), image.faults)), findings, statistics)
        }
        Err(error) => (Err(error), Vec::new(), statistics),
    }
}

/// Shards that the configuration asks for, or gaps in the numbering.
fn missing_shards(folder: &Path, numbers: &BTreeSet<u32>, config: Option<&SynthConfig>) -> Option<Finding> {
    let after_last = numbers.last().map_or(0, |last| u64::from(*last) + 1);
    let expected = config.map_or(after_last, |c| c.images.div_ceil(c.images_per_shard.max(1)) as u64);
    let there = numbers.iter().filter(|n| u64::from(**n) < expected).count() as u64;
    let is_missing = |n: &u64| u32::try_from(*n).map_or(true, |n| !numbers.contains(&n));
    let first: Vec<String> = (0..expected).filter(is_missing).take(5).map(|n| n.to_string()).collect();
    (!first.is_empty()).then(|| {
        let (missing, list) = (expected - there, first.join(", "));
        Finding::new(folder.display(), format!("{missing} of {expected} shards missing: {list} ..."))
    })
}

/// Shards with fewer images than the others; the last one of a set may be short.
fn short_shards(parts: &[PartReport], exact: bool) -> Vec<Finding> {
    let mut sizes: Vec<usize> = parts.iter().map(|p| p.images).collect();
    sizes.sort_unstable();
    let usual = sizes.get(sizes.len() / 2).copied().unwrap_or_default();
    let others = &parts[..parts.len().saturating_sub(1)];
    let short = |p: &&PartReport| if exact { p.images < usual } else { 2 * p.images < usual };
    others
        .iter()
        .filter(short)
        .map(|p| {
            Finding::new(&p.name, format!("{} images, the others have {usual}; {} bytes", p.images, p.bytes))
        })
        .collect()
}
