//! MegaPose sets: shards, their images, and whether all shards are there.

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use unopose_core::{config::SynthConfig, frame::Mask};
use unopose_dataset::formats::{FormatError, megapose::ShardFile, rle::Rle};

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
                Ok(count) => {
                    image.instances = Some(count);
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

/// Instances of an image, or why it has none; what is wrong with it; its distributions.
type CheckedKey = (Result<usize, FormatError>, Vec<Finding>, Statistics);

fn check_key(shard: &ShardFile, path: &Path, key: &str, models: &Models) -> CheckedKey {
    let (mut statistics, place) = (Statistics::default(), format!("{}: {key}", path.display()));
    let read = shard.read(key).and_then(|(annotated, records)| {
        let frame = annotated.frame;
        let decode = |rle: &Rle| -> Result<Mask, FormatError> {
            let mask = rle.decode()?;
            if (mask.width, mask.height) == (frame.width(), frame.height()) {
                return Ok(mask);
            }
            let size = format!("{} x {}", mask.width, mask.height);
            Err(FormatError::field("mask", "size", size, "that of the image"))
        };
        let masks =
            records.mask.iter().map(decode).collect::<Result<Vec<_>, _>>().map_err(|e| e.within(&place))?;
        let visible = annotated.instances.into_iter().map(|i| i.mask_visib).collect();
        let image = ImageUnderCheck {
            place: place.clone(),
            frame: &frame,
            gt: &records.gt,
            info: &records.gt_info,
            masks,
            visible,
        };
        Ok((records.gt.len(), image.check(models, &mut statistics)))
    });
    match read {
        Ok((count, findings)) => (Ok(count), findings, statistics),
        Err(error) => (Err(error), Vec::new(), statistics),
    }
}

/// Shards that the configuration asks for, or gaps in the numbering.
fn missing_shards(folder: &Path, numbers: &BTreeSet<u32>, config: Option<&SynthConfig>) -> Option<Finding> {
    let last = numbers.last().copied().unwrap_or_default();
    let expected = config.map_or(last + 1, |c| c.images.div_ceil(c.images_per_shard.max(1)) as u32);
    let missing: Vec<u32> = (0..expected).filter(|n| !numbers.contains(n)).collect();
    let first: Vec<String> = missing.iter().take(5).map(u32::to_string).collect();
    (!missing.is_empty()).then(|| {
        let list = first.join(", ");
        Finding::new(folder.display(), format!("{} of {expected} shards missing: {list} ...", missing.len()))
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
