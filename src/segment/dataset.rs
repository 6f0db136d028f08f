//! The targets of a BOP dataset: detections of every image, kept per image so that an interrupted run goes on.

use std::{
    collections::BTreeMap,
    hash::{DefaultHasher, Hash, Hasher},
    path::Path,
    sync::Arc,
};

use serde::{Deserialize, Serialize};

use super::{Matcher, SegmentError, UnoSeg};
use crate::{
    formats::{
        BopSplit, FormatError, ReferenceTarget,
        detections::Detection,
        files::{read_json, write_json},
    },
    registration::MaskedView,
};

/// Objects kept in memory at most.
const KEPT_OBJECTS: usize = 64;

/// Everything found in the images of a target list.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct DatasetSegmentation {
    pub detections: Vec<Detection>,
    /// All proposals; their category is 0.
    pub proposals: Vec<Detection>,
    /// Seconds of each image, proposals and matching together, without files and references.
    pub seconds: Vec<f64>,
    /// Seconds of each image's proposals.
    pub proposal_seconds: Vec<f64>,
    /// References that could not be used, with the reason.
    pub unusable: Vec<(ReferenceKey, String)>,
}

/// Scene, image, object of a reference.
pub type ReferenceKey = (u32, u32, u32);

/// Result of one image on disk.
#[derive(Serialize, Deserialize)]
struct Kept {
    key: String,
    detections: Vec<Detection>,
    proposals: Vec<Detection>,
    seconds: f64,
    proposal_seconds: f64,
}

/// Detects the objects of a target list in its images, each with its references in `references`. Results of single
/// images are kept in the folder `keep` and taken from there when nothing that decides about them has changed.
/// `progress` is called with the images done and all images.
pub fn segment_targets<M: Matcher>(
    unoseg: &UnoSeg<'_, M>,
    targets: &[ReferenceTarget],
    split: &BopSplit,
    references: &BopSplit,
    keep: &Path,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<DatasetSegmentation, SegmentError> {
    let mut images: BTreeMap<(u32, u32), Vec<ReferenceKey>> = BTreeMap::new();
    for target in targets {
        let wanted = images.entry((target.scene_id, target.im_id)).or_default();
        let key = (target.ref_scene_id, target.ref_im_id, target.obj_id);
        if !wanted.contains(&key) {
            wanted.push(key);
        }
    }
    let mut objects = Objects { unoseg, split: references, kept: BTreeMap::new(), unusable: BTreeMap::new() };
    let mut all = DatasetSegmentation::default();
    let total = images.len();
    for (done, (&(scene_id, im_id), wanted)) in images.iter().enumerate() {
        progress(done, total);
        let scene = split.scene(scene_id)?;
        let key = fingerprint(&unoseg.fingerprint(), &scene.folder, im_id, wanted);
        let path = keep.join(format!("{scene_id:06}_{im_id:06}.json"));
        let kept = read_json::<Kept>(&path).ok().filter(|kept| kept.key == key);
        let kept = match kept {
            Some(kept) => kept,
            None => {
                let kept = image(unoseg, &mut objects, key, (scene_id, im_id), split, wanted)?;
                write_json(&path, &kept, false)?;
                kept
            }
        };
        all.detections.extend(kept.detections);
        all.proposals.extend(kept.proposals);
        all.seconds.push(kept.seconds);
        all.proposal_seconds.push(kept.proposal_seconds);
    }
    progress(total, total);
    all.unusable = objects.unusable.into_iter().collect();
    Ok(all)
}

fn image<M: Matcher>(
    unoseg: &UnoSeg<'_, M>,
    objects: &mut Objects<'_, '_, M>,
    key: String,
    (scene_id, im_id): (u32, u32),
    split: &BopSplit,
    wanted: &[ReferenceKey],
) -> Result<Kept, SegmentError> {
    let frame = split.scene(scene_id)?.frame(im_id)?;
    let mut usable: Vec<(u32, Arc<M::Object>)> = Vec::new();
    for &reference in wanted {
        if let Some(object) = objects.get(reference)? {
            usable.push((reference.2, object));
        }
    }
    let list: Vec<&M::Object> = usable.iter().map(|(_, object)| object.as_ref()).collect();
    let found = unoseg.segment(&frame, Some((scene_id, im_id)), &list)?;
    let time = found.seconds;
    let detections = found.found.iter().filter_map(|assigned| {
        let obj_id = usable.get(assigned.object)?.0;
        let proposal = found.proposals.get(assigned.proposal)?;
        Some(proposal.detection(scene_id, im_id, obj_id, assigned.score, time))
    });
    let proposals = found.proposals.iter().map(|proposal| {
        proposal.detection(scene_id, im_id, 0, f64::from(proposal.score), found.proposal_seconds)
    });
    Ok(Kept {
        key,
        detections: detections.collect(),
        proposals: proposals.collect(),
        seconds: found.seconds,
        proposal_seconds: found.proposal_seconds,
    })
}

fn fingerprint(method: &str, scene: &Path, im_id: u32, wanted: &[ReferenceKey]) -> String {
    let mut hasher = DefaultHasher::new();
    (method, scene, im_id, wanted).hash(&mut hasher);
    format!("{} {:016x}", env!("CARGO_PKG_VERSION"), hasher.finish())
}

/// References as objects, made on demand.
struct Objects<'a, 'b, M: Matcher> {
    unoseg: &'a UnoSeg<'b, M>,
    split: &'a BopSplit,
    kept: BTreeMap<ReferenceKey, Arc<M::Object>>,
    unusable: BTreeMap<ReferenceKey, String>,
}

impl<M: Matcher> Objects<'_, '_, M> {
    /// The most visible instance in the reference image; `None`, with the reason noted, when it is of no use.
    fn get(&mut self, key: ReferenceKey) -> Result<Option<Arc<M::Object>>, SegmentError> {
        if let Some(object) = self.kept.get(&key) {
            return Ok(Some(object.clone()));
        }
        if self.unusable.contains_key(&key) {
            return Ok(None);
        }
        let (scene_id, im_id, obj_id) = key;
        let scene = self.split.scene(scene_id)?;
        let instances = scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate();
        let of_object = instances.filter(|(_, (gt, _))| gt.obj_id == obj_id);
        let Some((index, _)) = of_object.max_by(|(_, a), (_, b)| a.1.visib_fract.total_cmp(&b.1.visib_fract))
        else {
            let place = scene.folder.join("scene_gt.json");
            let missing = format!("image {im_id} object {obj_id}");
            let hint = "the target list names it as a reference";
            return Err(FormatError::missing(place.display(), missing, hint).into());
        };
        let (frame, mask) = (scene.frame(im_id)?, scene.mask_visib(im_id, index)?);
        match self.unoseg.matcher.object(&[MaskedView { frame: &frame, mask: &mask }]) {
            Ok(object) => {
                if self.kept.len() >= KEPT_OBJECTS {
                    self.kept.pop_first();
                }
                let object = Arc::new(object);
                self.kept.insert(key, object.clone());
                Ok(Some(object))
            }
            Err(SegmentError::Format(error)) => Err(error.into()),
            Err(error) => {
                self.unusable.insert(key, error.to_string());
                Ok(None)
            }
        }
    }
}
