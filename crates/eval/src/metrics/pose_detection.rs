//! Mean average precision of 6D detection in the style of the BOP challenge 2024: every estimate counts, so that false
//! alarms cost, with MSSD and MSPD as errors.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    MSPD_STEP, THRESHOLDS,
    average_precision::{average_precision, mean},
    matching::match_estimates,
    threshold,
};

/// Best estimates of an image that count.
pub const MAX_ESTIMATES: usize = 100;

/// The estimates of one object in one image.
#[derive(Clone, Debug)]
pub struct ObjectEstimates {
    /// Object of all of them.
    pub obj_id: u32,
    /// Of the estimates, descending.
    pub scores: Vec<f64>,
    /// `[estimate][instance]`, shares of the diameter.
    pub mssd: Vec<Vec<f64>>,
    /// `[estimate][instance]`, pixels of an image 640 pixels wide.
    pub mspd: Vec<Vec<f64>>,
    /// Which annotated instances are to be found; what matches another one is neither a hit nor a false alarm.
    pub counted: Vec<bool>,
}

/// Mean average precisions, each in 0..=1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PoseAveragePrecision {
    /// Mean of those of MSSD and MSPD.
    #[serde(rename = "mAP")]
    pub map: f64,
    /// With MSSD as error, thresholds 0.05 to 0.5 of the diameter.
    #[serde(rename = "mAP_MSSD")]
    pub map_mssd: f64,
    /// With MSPD as error, thresholds 5 to 50 pixels at an image width of 640.
    #[serde(rename = "mAP_MSPD")]
    pub map_mspd: f64,
    /// Average precision by object, mean of both errors.
    #[serde(rename = "AP_per_object")]
    pub per_object: BTreeMap<u32, f64>,
}

impl PoseAveragePrecision {
    /// Means over the thresholds, then over the objects that have an instance to be found.
    pub(super) fn new(images: &[ObjectEstimates]) -> Self {
        let mut objects: BTreeMap<u32, Vec<&ObjectEstimates>> = BTreeMap::new();
        for image in images {
            objects.entry(image.obj_id).or_default().push(image);
        }
        let objects: Vec<_> = objects.into_iter().collect();
        let scored: Vec<(u32, [f64; 2])> = objects
            .par_iter()
            .filter_map(|(obj_id, images)| {
                let mssd = over_thresholds(images, |i| &i.mssd, threshold)?;
                let mspd = over_thresholds(images, |i| &i.mspd, |th| MSPD_STEP * (th + 1) as f64)?;
                Some((*obj_id, [mssd, mspd]))
            })
            .collect();
        let of = |error: usize| mean(scored.iter().map(|(_, ap)| ap[error])).unwrap_or_default();
        let (map_mssd, map_mspd) = (of(0), of(1));
        Self {
            map: 0.5 * (map_mssd + map_mspd),
            map_mssd,
            map_mspd,
            per_object: scored.into_iter().map(|(id, ap)| (id, 0.5 * (ap[0] + ap[1]))).collect(),
        }
    }
}

fn over_thresholds(
    images: &[&ObjectEstimates],
    errors: impl Fn(&ObjectEstimates) -> &Vec<Vec<f64>>,
    threshold: impl Fn(usize) -> f64,
) -> Option<f64> {
    let positives = images.iter().flat_map(|i| &i.counted).filter(|&&counted| counted).count();
    let precisions = (0..THRESHOLDS).map(|th| {
        let ranked = images.iter().flat_map(|image| {
            let matches = match_estimates(errors(image), threshold(th));
            let entry = |(&score, matched): (&f64, Option<usize>)| match matched {
                Some(g) if !image.counted[g] => None,
                matched => Some((score, matched.is_some())),
            };
            image.scores.iter().zip(matches).filter_map(entry).collect::<Vec<_>>()
        });
        average_precision(ranked.collect(), positives)
    });
    mean(precisions.collect::<Option<Vec<_>>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(obj_id: u32, estimates: &[(f64, &[f64])], counted: &[bool]) -> ObjectEstimates {
        let errors: Vec<Vec<f64>> = estimates.iter().map(|(_, errors)| errors.to_vec()).collect();
        let pixels = errors.iter().map(|row| row.iter().map(|e| e * 100.0).collect()).collect();
        ObjectEstimates {
            obj_id,
            scores: estimates.iter().map(|e| e.0).collect(),
            mssd: errors,
            mspd: pixels,
            counted: counted.to_vec(),
        }
    }

    #[test]
    fn false_alarms_cost_and_ignored_instances_do_not() {
        // Right at all ten thresholds; a worse scored false alarm does not matter, a better scored one halves it.
        let right = image(1, &[(0.9, &[0.01]), (0.2, &[0.9])], &[true]);
        assert_eq!(PoseAveragePrecision::new(std::slice::from_ref(&right)).map, 1.0);
        let late = image(1, &[(0.9, &[0.9]), (0.2, &[0.01])], &[true]);
        assert!((PoseAveragePrecision::new(&[late]).map - 0.5).abs() < 1e-12);
        // The better scored one lies on an ignored instance.
        let ignored = image(1, &[(0.9, &[0.9, 0.01]), (0.2, &[0.01, 0.9])], &[true, false]);
        assert_eq!(PoseAveragePrecision::new(&[ignored]).map, 1.0);
        // An estimate where there is no instance is a false alarm, too.
        let nowhere = image(1, &[(0.95, &[])], &[]);
        assert!((PoseAveragePrecision::new(&[right, nowhere]).map - 0.5).abs() < 1e-12);
    }

    #[test]
    fn thresholds_and_objects_are_averaged() {
        // 0.26 of the diameter is below 5 of 10 thresholds, 26 pixels as well; object 2 is never found.
        let half = image(1, &[(0.9, &[0.26])], &[true]);
        let map =
            PoseAveragePrecision::new(&[half, image(2, &[], &[true]), image(3, &[(0.5, &[0.0])], &[false])]);
        assert!((map.map - 0.25).abs() < 1e-12 && (map.map_mspd - 0.25).abs() < 1e-12, "{map:?}");
        assert_eq!(map.per_object.len(), 2);
        assert_eq!(PoseAveragePrecision::new(&[]), PoseAveragePrecision::default());
    }
}
