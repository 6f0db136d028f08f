//! Target lists: which instances are to be found, and in which image each one's reference view is.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde::{Deserialize, Serialize};

use super::{
    BopSplit, FormatError,
    files::{read_json, write_json},
    whole_numbers::{some_whole, whole},
};

/// Visible share below which an instance is not asked for by BOP's detection tasks.
pub const MIN_VISIBILITY: f64 = 0.1;

/// An entry of `test_targets_bop19.json`: `inst_count` instances of an object in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Target {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Object to be found.
    pub obj_id: u32,
    /// Number of its instances in the image; 1 where the file does not say, as in lists of references. 0: none is to be
    /// found, and every result is a false alarm.
    pub inst_count: u32,
}

/// An entry of a list as it is in the file. BOP's lists of 2024 name images alone: every object in them is to be found.
#[derive(Deserialize)]
struct TargetRecord {
    #[serde(deserialize_with = "whole")]
    scene_id: u32,
    #[serde(deserialize_with = "whole")]
    im_id: u32,
    #[serde(default, deserialize_with = "some_whole")]
    obj_id: Option<u32>,
    #[serde(default, deserialize_with = "some_whole")]
    inst_count: Option<u32>,
}

/// An entry of `test_ref_targets_*.json`: a target and the image that shows its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceTarget {
    /// Scene of the target's image.
    #[serde(deserialize_with = "whole")]
    pub scene_id: u32,
    /// Number of the target's image in its scene.
    #[serde(deserialize_with = "whole")]
    pub im_id: u32,
    /// Object to be found, which both images show.
    #[serde(deserialize_with = "whole")]
    pub obj_id: u32,
    /// Scene of the reference's image.
    #[serde(deserialize_with = "whole")]
    pub ref_scene_id: u32,
    /// Number of the reference's image in its scene.
    #[serde(deserialize_with = "whole")]
    pub ref_im_id: u32,
    /// Angle between target and reference view, degrees, where the list has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rot_deg: Option<f64>,
    /// Share of the target's visible surface that the reference sees, where the list has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub overlap: Option<f64>,
}

/// Reads a target list, sorted by scene, image and object; repeated entries (a target with several
/// references) count once. A list of references is a target list too. A list of images alone is refused.
pub fn read_targets(path: &Path) -> Result<Vec<Target>, FormatError> {
    match read_list(path)? {
        List::Targets(targets) => Ok(targets),
        List::Images(_) => {
            let hint = "a list of images alone; test_targets_bop19.json has the objects";
            Err(FormatError::missing(path.display(), "obj_id", hint))
        }
    }
}

/// Reads a target list and checks it against the annotations: every scene, image and object is there. A list of images alone
/// asks for every object that is annotated there, as BOP's detection task of 2024 does: as many instances as are visible by
/// [`MIN_VISIBILITY`], and none of the objects that only other images of the list show.
pub fn read_annotated_targets(path: &Path, split: &BopSplit) -> Result<Vec<Target>, FormatError> {
    let place = path.display().to_string();
    match read_list(path)? {
        List::Targets(targets) => {
            check_targets(&targets, &place, split)?;
            Ok(targets)
        }
        List::Images(images) => annotated_objects(&images, &place, split),
    }
}

enum List {
    Targets(Vec<Target>),
    /// Scenes and images.
    Images(BTreeSet<(u32, u32)>),
}

fn read_list(path: &Path) -> Result<List, FormatError> {
    let mut targets: BTreeMap<(u32, u32, u32), Target> = BTreeMap::new();
    let mut images = BTreeSet::new();
    for (index, record) in read_json::<Vec<TargetRecord>>(path)?.into_iter().enumerate() {
        let TargetRecord { scene_id, im_id, obj_id, inst_count } = record;
        let place = || format!("{}: entry {index}", path.display());
        let (Some(obj_id), inst_count) = (obj_id, inst_count.unwrap_or(1)) else {
            images.insert((scene_id, im_id));
            if let Some(other) = targets.values().next() {
                let hint = format!("scene {} image {} has one", other.scene_id, other.im_id);
                return Err(FormatError::missing(place(), "obj_id", hint));
            }
            continue;
        };
        if let Some(first) = images.first() {
            let hint = format!("entry {index} has one");
            let place = format!("{}: scene {} image {}", path.display(), first.0, first.1);
            return Err(FormatError::missing(place, "obj_id", hint));
        }
        if inst_count == 0 {
            return Err(FormatError::field(place(), "inst_count", 0, "at least 1"));
        }
        let target = Target { scene_id, im_id, obj_id, inst_count };
        let entry = targets.entry((scene_id, im_id, obj_id)).or_insert(target);
        entry.inst_count = entry.inst_count.max(inst_count);
    }
    if targets.is_empty() && images.is_empty() {
        return Err(FormatError::field(path.display(), "list of targets", "empty", "at least one target"));
    }
    Ok(if images.is_empty() { List::Targets(targets.into_values().collect()) } else { List::Images(images) })
}

/// All objects in all images, with the number of instances that are to be found.
fn annotated_objects(
    images: &BTreeSet<(u32, u32)>,
    place: &str,
    split: &BopSplit,
) -> Result<Vec<Target>, FormatError> {
    let mut counts: BTreeMap<(u32, u32), BTreeMap<u32, u32>> = BTreeMap::new();
    let mut hidden = None;
    for &(scene_id, im_id) in images {
        let place = format!("{place}: scene {scene_id} image {im_id}");
        check_image(split, [scene_id, im_id], ["scene_id", "im_id"], &place)?;
        let scene = split.scene(scene_id)?;
        if !scene.is_annotated(im_id) {
            hidden = Some(scene.gt_file().display().to_string());
            continue;
        }
        match scene.gt(im_id).and_then(|gt| Ok((gt, scene.gt_info(im_id)?))) {
            Ok((gt, infos)) => {
                let of_image = counts.entry((scene_id, im_id)).or_default();
                for (gt, _) in gt.iter().zip(infos).filter(|(_, info)| info.visib_fract >= MIN_VISIBILITY) {
                    *of_image.entry(gt.obj_id).or_default() += 1;
                }
            }
            Err(error) => tracing::warn!("{error}: the image is left out"),
        }
    }
    let objects: BTreeSet<u32> = counts.values().flat_map(BTreeMap::keys).copied().collect();
    if objects.is_empty() {
        let hint = match hidden {
            Some(file) => format!("the list names images alone, and {file} has no annotation of them"),
            None => "the list names images alone, and their annotations have no visible object".into(),
        };
        return Err(FormatError::missing(place, "obj_id", hint));
    }
    let targets = counts.iter().flat_map(|(&(scene_id, im_id), of_image)| {
        objects.iter().map(move |obj_id| {
            let inst_count = of_image.get(obj_id).copied().unwrap_or(0);
            Target { scene_id, im_id, obj_id: *obj_id, inst_count }
        })
    });
    Ok(targets.collect())
}

/// Reads a list of references, in the order of the file.
pub fn read_reference_targets(path: &Path) -> Result<Vec<ReferenceTarget>, FormatError> {
    let targets: Vec<ReferenceTarget> = read_json(path)?;
    if targets.is_empty() {
        return Err(FormatError::field(path.display(), "list of targets", "empty", "at least one target"));
    }
    Ok(targets)
}

/// Checks a list of references against the annotations: every scene, image and object is there, and no entry is repeated.
/// `place` is the list in messages. A target's image without annotation may show anything; a reference needs one.
pub(crate) fn check_reference_targets(
    targets: &[ReferenceTarget],
    place: &str,
    split: &BopSplit,
    reference_split: &BopSplit,
) -> Result<(), FormatError> {
    let mut seen: BTreeMap<[u32; 5], usize> = BTreeMap::new();
    for (index, t) in targets.iter().enumerate() {
        let place = format!("{place}: entry {index}");
        if let Some(first) = seen.insert([t.scene_id, t.im_id, t.obj_id, t.ref_scene_id, t.ref_im_id], index)
        {
            let expected = format!("a target and reference other than those of entry {first}");
            return Err(FormatError::field(place, "entry", "a repetition", expected));
        }
        check_object(split, [t.scene_id, t.im_id, t.obj_id], ["scene_id", "im_id"], &place)?;
        let reference = [t.ref_scene_id, t.ref_im_id, t.obj_id];
        check_object(reference_split, reference, ["ref_scene_id", "ref_im_id"], &place)?;
        let scene = reference_split.scene(t.ref_scene_id)?;
        if !scene.is_annotated(t.ref_im_id) {
            let hint =
                format!("{place} takes its reference from there; --reference-split names another split");
            let missing = format!("image {}", t.ref_im_id);
            return Err(FormatError::missing(scene.gt_file().display(), missing, hint));
        }
    }
    Ok(())
}

fn check_targets(targets: &[Target], place: &str, split: &BopSplit) -> Result<(), FormatError> {
    targets.iter().try_for_each(|t| {
        let place = format!("{place}: scene {} image {} object {}", t.scene_id, t.im_id, t.obj_id);
        check_object(split, [t.scene_id, t.im_id, t.obj_id], ["scene_id", "im_id"], &place)
    })
}

/// Broken entries of an image are for those who use them.
fn check_object(
    split: &BopSplit,
    [scene_id, im_id, obj_id]: [u32; 3],
    fields: [&str; 2],
    place: &str,
) -> Result<(), FormatError> {
    check_image(split, [scene_id, im_id], fields, place)?;
    let scene = split.scene(scene_id)?;
    let Ok(annotated) = scene.gt(im_id) else { return Ok(()) };
    if annotated.iter().any(|gt| gt.obj_id == obj_id) {
        return Ok(());
    }
    let there: BTreeSet<u32> = annotated.iter().map(|gt| gt.obj_id).collect();
    let expected = format!("an object annotated in {} image {im_id}: {there:?}", scene.gt_file().display());
    Err(FormatError::field(place, "obj_id", obj_id, expected))
}

fn check_image(
    split: &BopSplit,
    [scene_id, im_id]: [u32; 2],
    fields: [&str; 2],
    place: &str,
) -> Result<(), FormatError> {
    if split.scene_folder(scene_id).is_none() {
        let other = if fields[0] == "ref_scene_id" { " (--reference-split names another split)" } else { "" };
        let expected = format!("a scene of {}: {:?}{other}", split.folder().display(), split.scene_ids());
        return Err(FormatError::field(place, fields[0], scene_id, expected));
    }
    let scene = split.scene(scene_id)?;
    if scene.image_ids().any(|id| id == im_id) {
        return Ok(());
    }
    let expected = format!("an image of {}", scene.camera_file().display());
    Err(FormatError::field(place, fields[1], im_id, expected))
}

/// Writes either kind of list.
pub fn write_targets<T: Serialize>(path: &Path, targets: &[T]) -> Result<(), FormatError> {
    write_json(path, targets, true)
}

#[cfg(test)]
#[path = "targets_tests.rs"]
mod tests;
