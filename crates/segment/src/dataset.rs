//! The targets of a BOP dataset: detections of every image, kept per image so that an interrupted run can be resumed.

use std::{
    collections::BTreeMap,
    hash::{DefaultHasher, Hash, Hasher},
    path::Path,
    sync::Arc,
};

use serde::{Deserialize, Serialize};
use unopose_dataset::formats::{
    BopSplit, ReferenceTarget,
    detections::Detection,
    files::{read_json, write_json},
};

use super::{
    Matcher, SegmentError, UnoSeg,
    objects::{ObjectCache, ObjectKey, ObjectViews},
};

/// Everything found in the images of a target list.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct DatasetSegmentation {
    /// The objects found, image by image, in each by descending score.
    pub detections: Vec<Detection>,
    /// All proposals; their category is 0.
    pub proposals: Vec<Detection>,
    /// Seconds of each image, proposals and matching together, without files and the objects' views.
    pub seconds: Vec<f64>,
    /// Seconds of each image's proposals.
    pub proposal_seconds: Vec<f64>,
    /// Objects whose views could not be used, with the reason.
    pub unusable: Vec<(ObjectKey, String)>,
}

/// Result of one image on disk.
#[derive(Serialize, Deserialize)]
struct StoredImage {
    key: String,
    detections: Vec<Detection>,
    proposals: Vec<Detection>,
    seconds: f64,
    proposal_seconds: f64,
}

/// Detects the objects of a target list in its images, each by its views. Results of single images are kept in the folder
/// `cache` and taken from there when nothing that decides about them has changed. `progress` is called with the images
/// done and all images.
pub fn segment_targets<M: Matcher>(
    unoseg: &UnoSeg<'_, M>,
    targets: &[ReferenceTarget],
    split: &BopSplit,
    views: &ObjectViews<'_>,
    cache: &Path,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<DatasetSegmentation, SegmentError> {
    let mut images: BTreeMap<(u32, u32), Vec<&ReferenceTarget>> = BTreeMap::new();
    for target in targets {
        let wanted = images.entry((target.scene_id, target.im_id)).or_default();
        if wanted.iter().all(|other| views.key(other) != views.key(target)) {
            wanted.push(target);
        }
    }
    let method = format!("{} {}", unoseg.fingerprint(), views.fingerprint());
    let mut objects = ObjectCache::new(unoseg.matcher, views);
    let mut all = DatasetSegmentation::default();
    let total = images.len();
    for (done, (&(scene_id, im_id), wanted)) in images.iter().enumerate() {
        progress(done, total);
        let scene = split.scene(scene_id)?;
        let keys: Vec<ObjectKey> = wanted.iter().map(|target| views.key(target)).collect();
        let key = fingerprint(&method, &scene.folder, im_id, &keys);
        let path = cache.join(format!("{scene_id:06}_{im_id:06}.json"));
        let kept = read_json::<StoredImage>(&path).ok().filter(|kept| kept.key == key);
        let kept = match kept {
            Some(kept) => kept,
            None => match image(unoseg, &mut objects, key, (scene_id, im_id), split, wanted)? {
                Some(kept) => {
                    write_json(&path, &kept, false)?;
                    kept
                }
                None => continue,
            },
        };
        all.detections.extend(kept.detections);
        all.proposals.extend(kept.proposals);
        all.seconds.push(kept.seconds);
        all.proposal_seconds.push(kept.proposal_seconds);
    }
    progress(total, total);
    all.unusable = objects.into_unusable();
    Ok(all)
}

/// `None`, with a warning, for an image that cannot be read.
fn image<M: Matcher>(
    unoseg: &UnoSeg<'_, M>,
    objects: &mut ObjectCache<'_, M>,
    key: String,
    (scene_id, im_id): (u32, u32),
    split: &BopSplit,
    wanted: &[&ReferenceTarget],
) -> Result<Option<StoredImage>, SegmentError> {
    let frame = match split.scene(scene_id)?.frame(im_id) {
        Ok(frame) => frame,
        Err(error) => {
            tracing::warn!("{error}: nothing is found in scene {scene_id} image {im_id}");
            return Ok(None);
        }
    };
    let mut usable: Vec<(u32, Arc<M::Object>)> = Vec::new();
    for target in wanted {
        if let Some(object) = objects.get(target)? {
            usable.push((target.obj_id, object));
        }
    }
    let list: Vec<&M::Object> = usable.iter().map(|(_, object)| object.as_ref()).collect();
    let found = unoseg.segment(&frame, Some((scene_id, im_id)), &list)?;
    let time = found.seconds;
    let detections = found.found.iter().filter_map(|found| {
        let obj_id = usable.get(found.object)?.0;
        Some(found.mask.detection(scene_id, im_id, obj_id, found.score, time))
    });
    let proposals = found.proposals.iter().map(|proposal| {
        proposal.detection(scene_id, im_id, 0, f64::from(proposal.score), found.proposal_seconds)
    });
    Ok(Some(StoredImage {
        key,
        detections: detections.collect(),
        proposals: proposals.collect(),
        seconds: found.seconds,
        proposal_seconds: found.proposal_seconds,
    }))
}

fn fingerprint(method: &str, scene: &Path, im_id: u32, wanted: &[ObjectKey]) -> String {
    let mut hasher = DefaultHasher::new();
    (method, scene, im_id, wanted).hash(&mut hasher);
    format!("{} {:016x}", env!("CARGO_PKG_VERSION"), hasher.finish())
}
