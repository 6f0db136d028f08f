//! Samples of a dataset, summarised by check.

use std::{collections::BTreeMap, path::Path};

use rayon::prelude::*;
use unopose_core::frame::MaskedView;
use unopose_dataset::formats::{
    AnnotatedFrame, BopDataset, BopSplit, FormatError, Instance, megapose::ShardDataset,
};

use super::{Check, Expected, Finding, Level, MaskedObject, findings};

/// Instances that are less visible than this, or smaller, are left out: little can be said of them.
const VISIBLE: f64 = 0.3;
const PIXELS: usize = 400;
/// Share of the instances with a finding from which on the whole set has it.
const SHARE: f64 = 0.1;
/// Measured distance over annotated distance, and its inverse: an object's front is a little nearer than its origin.
const DISTANCE_RATIO: [f64; 2] = [1.35, 2.0];

/// Which images of a dataset are looked at.
#[derive(Clone, Debug)]
pub struct Sampling {
    /// Images, evenly over the set.
    pub images: usize,
    /// Split of a BOP dataset; `None`: its test split, or else its first one.
    pub split: Option<String>,
    /// Camera of scenes with several, `cam1` in `rgb_cam1/`.
    pub sensor: Option<String>,
    /// Points that the network samples.
    pub points: usize,
}

/// An instance that was looked at.
#[derive(Clone, Debug)]
pub struct SampledInstance {
    /// Image and instance, or the image alone when it cannot be read.
    pub place: String,
    /// Of every check.
    pub findings: Vec<Finding>,
}

/// What was found in a dataset.
#[derive(Clone, Debug)]
pub struct DatasetReport {
    /// Images that were looked at.
    pub images: usize,
    /// In the order of the dataset.
    pub instances: Vec<SampledInstance>,
}

/// How often a check was passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckSummary {
    /// What was looked at.
    pub check: Check,
    /// Instances by level: ok, look, wrong.
    pub counts: [usize; 3],
    /// The level of the whole set: that of at least a tenth of the instances; `Look` when a single one is wrong.
    pub level: Level,
}

impl DatasetReport {
    /// One summary per check.
    pub fn summaries(&self) -> Vec<CheckSummary> {
        let mut counts: BTreeMap<Check, [usize; 3]> = BTreeMap::new();
        for finding in self.instances.iter().flat_map(|instance| &instance.findings) {
            counts.entry(finding.check).or_default()[finding.level as usize] += 1;
        }
        let summary = |(check, counts): (Check, [usize; 3])| {
            let least = SHARE * counts.iter().sum::<usize>() as f64;
            let level = match counts {
                [.., wrong] if wrong as f64 >= least.max(1.0) => Level::Wrong,
                [_, look, wrong] if (look + wrong) as f64 >= least.max(1.0) || wrong > 0 => Level::Look,
                _ => Level::Ok,
            };
            CheckSummary { check, counts, level }
        };
        counts.into_iter().map(summary).collect()
    }

    /// Findings that are not ok, the worst first, at most `count` of each check.
    pub fn worst(&self, count: usize) -> Vec<(&str, &Finding)> {
        let mut found: Vec<(&str, &Finding)> = self
            .instances
            .iter()
            .flat_map(|instance| instance.findings.iter().map(|finding| (instance.place.as_str(), finding)))
            .filter(|(_, finding)| finding.level > Level::Ok)
            .collect();
        found.sort_by_key(|(_, finding)| (std::cmp::Reverse(finding.level), finding.check));
        let mut taken: BTreeMap<Check, usize> = BTreeMap::new();
        found.retain(|(_, finding)| {
            let taken = taken.entry(finding.check).or_default();
            *taken += 1;
            *taken <= count
        });
        found
    }
}

/// Looks at a sample of a BOP dataset or of a folder of MegaPose shards.
pub fn examine_dataset(folder: &Path, sampling: &Sampling) -> Result<DatasetReport, FormatError> {
    let dataset = BopDataset::open(folder)?.with_sensor(sampling.sensor.clone());
    let splits = dataset.splits()?;
    if splits.is_empty() {
        return examine_shards(&ShardDataset::open(folder)?, sampling);
    }
    let split = match (&sampling.split, dataset.test_split()) {
        (Some(name), _) => dataset.split(name)?,
        (None, Ok(split)) => split,
        (None, Err(_)) => dataset.split(&splits[0])?,
    };
    examine_split(&split, sampling)
}

fn examine_split(split: &BopSplit, sampling: &Sampling) -> Result<DatasetReport, FormatError> {
    let mut images = Vec::new();
    for &scene_id in split.scene_ids() {
        images.extend(split.scene(scene_id)?.image_ids().map(|im_id| (scene_id, im_id)));
    }
    Ok(examine(&images, sampling, |&(scene_id, im_id)| {
        let folder = split.scene_folder(scene_id).unwrap_or(split.folder());
        let place = format!("{}: image {im_id}", folder.display());
        let scale = split.scene(scene_id).and_then(|scene| scene.camera(im_id)).ok();
        (place, split.load(scene_id, im_id), scale.and_then(|camera| camera.depth_scale))
    }))
}

fn examine_shards(dataset: &ShardDataset, sampling: &Sampling) -> Result<DatasetReport, FormatError> {
    let images: Vec<u32> = (0..).zip(dataset.image_keys()).map(|(image, _)| image).collect();
    Ok(examine(&images, sampling, |&image| {
        let key = dataset.image_keys().get(image as usize).map_or("", String::as_str);
        (format!("{}: {key}", dataset.folder().display()), dataset.load(image), None)
    }))
}

type Loaded = (String, Result<AnnotatedFrame, FormatError>, Option<f64>);

fn examine<T: Sync>(images: &[T], sampling: &Sampling, load: impl Fn(&T) -> Loaded + Sync) -> DatasetReport {
    let count = sampling.images.min(images.len());
    let chosen: Vec<&T> = (0..count).map(|i| &images[i * images.len() / count]).collect();
    let image = |image: &&T| -> Vec<SampledInstance> {
        let (place, loaded, depth_scale) = load(image);
        let expected = Expected { depth_scale, points: sampling.points };
        match loaded {
            Ok(annotated) => instances(&place, &annotated, &expected),
            Err(error) => {
                let finding = Finding::new(Check::Images, Level::Wrong, error.to_string());
                vec![SampledInstance { place, findings: vec![finding] }]
            }
        }
    };
    let instances: Vec<Vec<SampledInstance>> = chosen.par_iter().map(image).collect();
    DatasetReport { images: count, instances: instances.into_iter().flatten().collect() }
}

fn instances(place: &str, image: &AnnotatedFrame, expected: &Expected) -> Vec<SampledInstance> {
    let large =
        |instance: &Instance| instance.visib_fract >= VISIBLE && instance.mask_visib.count() >= PIXELS;
    let looked_at = image.instances.iter().enumerate().filter(|(_, instance)| large(instance));
    looked_at
        .map(|(i, instance)| {
            let view = MaskedView { frame: &image.frame, mask: &instance.mask_visib };
            let mut findings = findings(view, expected);
            findings.extend(annotation_finding(view, instance));
            SampledInstance { place: format!("{place}, instance {i} (object {})", instance.obj_id), findings }
        })
        .collect()
}

/// The measured distance against that of the annotated pose.
fn annotation_finding(view: MaskedView<'_>, instance: &Instance) -> Option<Finding> {
    let object = MaskedObject::measure(&view.points())?;
    let annotated = instance.t_camera_object.translation.norm();
    let ratio = object.distance / annotated;
    let level =
        if ratio.is_finite() { Level::of(ratio.max(1.0 / ratio), DISTANCE_RATIO) } else { Level::Wrong };
    let text =
        format!("depth puts the object at {:.3} m, the annotated pose at {annotated:.3} m", object.distance);
    Some(
        Finding::new(Check::Annotation, level, text)
            .with_values([("distance_m", object.distance), ("annotated_m", annotated)])
            .advise(format!(
                "a depth_scale about {:.4} times the present one would fit; or the poses are not in millimetres, or the mask is \
                 another object's",
                1.0 / ratio
            )),
    )
}
