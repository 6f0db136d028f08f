//! Groups of targets by visibility and by the rotation between target and reference view.

use std::collections::BTreeMap;

use unopose_dataset::formats::{BopDataset, BopSplit, ReferenceTarget};

use super::EvalError;

/// Limits of the visibility bins.
pub const VISIBILITY_EDGES: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
/// Limits of the rotation bins, degrees.
pub const ROTATION_EDGES: [f64; 11] = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 180.0];

/// Bin of a value: lower limit included, upper excluded but for the last; values outside go to the first or
/// last bin.
pub fn bin_of(value: f64, edges: &[f64]) -> usize {
    edges[1..edges.len() - 1].iter().take_while(|&&edge| value >= edge).count()
}

/// Rotation between the views of target and reference, by scene, image and object.
#[derive(Clone, Debug, Default)]
pub struct RotationBins {
    degrees: BTreeMap<(u32, u32, u32), f64>,
}

impl RotationBins {
    /// Takes the angle a target list gives, or else computes it from the annotated poses (smallest over the
    /// symmetries, most visible instance on both sides). The nearest reference counts when a target has
    /// several.
    pub fn new(
        targets: &[ReferenceTarget],
        dataset: &BopDataset,
        target_split: &BopSplit,
        reference_split: &BopSplit,
    ) -> Result<Self, EvalError> {
        let infos = if targets.iter().all(|t| t.rot_deg.is_some()) {
            BTreeMap::new()
        } else {
            dataset.models_info()?
        };
        let mut degrees = BTreeMap::new();
        for target in targets {
            let angle = match (target.rot_deg, infos.get(&target.obj_id)) {
                (Some(angle), _) => angle,
                (None, Some(info)) => {
                    let pose = |split: &BopSplit, scene_id, im_id| {
                        split.scene(scene_id).and_then(|scene| scene.most_visible(im_id, target.obj_id))
                    };
                    let query = pose(target_split, target.scene_id, target.im_id);
                    let reference = pose(reference_split, target.ref_scene_id, target.ref_im_id);
                    // Hidden or broken annotations have no angle; who needs the poses says so.
                    let (Ok((_, t_query)), Ok((_, t_reference))) = (query, reference) else { continue };
                    info.symmetries.rotation_distance_deg(&t_query, &t_reference)
                }
                (None, None) => {
                    let file = dataset.models_info_place();
                    return Err(EvalError::UnknownObject { file, obj_id: target.obj_id });
                }
            };
            let key = (target.scene_id, target.im_id, target.obj_id);
            degrees.entry(key).and_modify(|d: &mut f64| *d = d.min(angle)).or_insert(angle);
        }
        Ok(Self { degrees })
    }

    /// Degrees between the views of a target and its nearest reference; `None` for what is no target of the list.
    pub fn degrees(&self, scene_id: u32, im_id: u32, obj_id: u32) -> Option<f64> {
        self.degrees.get(&(scene_id, im_id, obj_id)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_belong_to_the_upper_bin_but_for_the_last() {
        let bins = [0.0, 0.2, 0.35, 0.8, 1.0, 1.1].map(|v| bin_of(v, &VISIBILITY_EDGES));
        assert_eq!(bins, [0, 1, 1, 4, 4, 4]);
        assert_eq!([9.99, 90.0, 180.0].map(|v| bin_of(v, &ROTATION_EDGES)), [0, 9, 9]);
    }
}
