//! Searches and proposals whose outcome is known, for fitting the score of matches and the rank of proposals.

use std::collections::BTreeSet;

use unopose_core::frame::Mask;
use unopose_dataset::formats::{BopScene, BopSplit, FormatError, ReferenceTarget};

use super::{
    GeometricMatcher, LearnedProposals, ObservedMask, ObservedMatch, ProposalGenerator, SegmentError,
    objects::{ObjectCache, ObjectViews},
    recall::annotated_images,
};

/// Searches the images of a target list for the objects of their targets and for as many others of the list that they do not
/// show. An image that cannot be read is an error. `progress` is called with the images done and all images.
pub fn observe_matches(
    matcher: &GeometricMatcher<'_>,
    generator: &dyn ProposalGenerator,
    targets: &[ReferenceTarget],
    split: &BopSplit,
    references: &BopSplit,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Vec<ObservedMatch>, SegmentError> {
    let views = ObjectViews::References(references);
    let mut cache = ObjectCache::new(matcher, &views);
    let images: BTreeSet<(u32, u32)> = targets.iter().map(|t| (t.scene_id, t.im_id)).collect();
    let (mut observed, mut search) = (Vec::new(), 0);
    for (done, &(scene_id, im_id)) in images.iter().enumerate() {
        progress(done, images.len());
        let scene = split.scene(scene_id)?;
        let frame = scene.frame(im_id)?;
        let proposals = generator.proposals(&frame, Some((scene_id, im_id)))?;
        for target in wanted(targets, &scene, im_id, done)? {
            let Some(object) = cache.get(target)? else { continue };
            let truth = instances(&scene, im_id, target.obj_id)?;
            let evidence = matcher.evidence(&frame, &proposals, &[&object])?;
            for posed in evidence.into_iter().flatten() {
                let mask = &proposals[posed.proposal].mask;
                observed.push(ObservedMatch {
                    search,
                    present: !truth.is_empty(),
                    iou: truth.iter().map(|truth| truth.iou(mask)).fold(0.0, f64::max),
                    evidence: posed.evidence,
                });
            }
            search += 1;
        }
    }
    progress(images.len(), images.len());
    Ok(observed)
}

/// The candidates of all annotated images of a split with their overlap with the objects, at most `limit` images. Images
/// without depth are left out. `progress` is called with the images done and all images.
pub fn observe_masks(
    proposals: &LearnedProposals,
    split: &BopSplit,
    limit: usize,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Vec<ObservedMask>, SegmentError> {
    let images = annotated_images(split, limit)?;
    let mut observed = Vec::new();
    for (image, &(scene_id, im_id)) in images.iter().enumerate() {
        progress(image, images.len());
        let annotated = split.load(scene_id, im_id)?;
        let candidates = match proposals.candidates(&annotated.frame) {
            Err(SegmentError::Scene(error)) => {
                tracing::warn!("scene {scene_id}, image {im_id}: {error}; left out");
                continue;
            }
            candidates => candidates?,
        };
        let truth = || annotated.instances.iter().map(|instance| &instance.mask_visib);
        observed.extend(candidates.into_iter().map(|(proposal, evidence)| {
            let iou = truth().map(|mask| mask.iou(&proposal.mask)).fold(0.0, f64::max);
            ObservedMask { image, iou, evidence }
        }));
    }
    progress(images.len(), images.len());
    Ok(observed)
}

/// One target per object of the image, then as many of other objects; which ones differs from image to image.
fn wanted<'a>(
    targets: &'a [ReferenceTarget],
    scene: &BopScene,
    im_id: u32,
    image: usize,
) -> Result<Vec<&'a ReferenceTarget>, FormatError> {
    let shown: BTreeSet<u32> = scene.gt(im_id)?.iter().map(|gt| gt.obj_id).collect();
    let mut seen = BTreeSet::new();
    let of_image = targets.iter().filter(|t| (t.scene_id, t.im_id) == (scene.id, im_id));
    let mut wanted: Vec<&ReferenceTarget> = of_image.filter(|t| seen.insert(t.obj_id)).collect();
    let mut others: Vec<&ReferenceTarget> =
        targets.iter().filter(|t| !shown.contains(&t.obj_id) && seen.insert(t.obj_id)).collect();
    if !others.is_empty() {
        let count = others.len();
        others.rotate_left(image * wanted.len() % count);
    }
    wanted.extend(others.into_iter().take(wanted.len()));
    Ok(wanted)
}

/// Visible masks of the instances of an object.
fn instances(scene: &BopScene, im_id: u32, obj_id: u32) -> Result<Vec<Mask>, FormatError> {
    let gt = scene.gt(im_id)?.iter().enumerate().filter(|(_, gt)| gt.obj_id == obj_id);
    let masks = gt.map(|(index, _)| scene.mask_visib(im_id, index));
    // Instances that are hidden altogether have an empty mask.
    Ok(masks.collect::<Result<Vec<_>, _>>()?.into_iter().filter(|mask| mask.count() > 0).collect())
}
