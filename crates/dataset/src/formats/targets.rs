//! Target lists: which instances are to be found, and in which image each one's reference view is.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};

use super::{
    BopSplit, FormatError,
    files::{read_json, write_json},
};

/// An entry of `test_targets_bop19.json`: `inst_count` instances of an object in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Target {
    /// Scene of the image.
    pub scene_id: u32,
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Object to be found.
    pub obj_id: u32,
    /// Number of its instances in the image; 1 where the file does not say, as in lists of references.
    #[serde(default = "one")]
    pub inst_count: u32,
}

fn one() -> u32 {
    1
}

/// An entry of `test_ref_targets_*.json`: a target and the image that shows its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceTarget {
    /// Scene of the target's image.
    pub scene_id: u32,
    /// Number of the target's image in its scene.
    pub im_id: u32,
    /// Object to be found, which both images show.
    pub obj_id: u32,
    /// Scene of the reference's image.
    pub ref_scene_id: u32,
    /// Number of the reference's image in its scene.
    pub ref_im_id: u32,
    /// Angle between target and reference view, degrees, where the list has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rot_deg: Option<f64>,
    /// Share of the target's visible surface that the reference sees, where the list has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub overlap: Option<f64>,
}

/// Reads a target list, sorted by scene, image and object; repeated entries (a target with several
/// references) count once. A list of references is a target list too.
pub fn read_targets(path: &Path) -> Result<Vec<Target>, FormatError> {
    let mut targets: BTreeMap<(u32, u32, u32), Target> = BTreeMap::new();
    for (index, target) in read_json::<Vec<Target>>(path)?.into_iter().enumerate() {
        if target.inst_count == 0 {
            let place = format!("{}: entry {index}", path.display());
            return Err(FormatError::field(place, "inst_count", 0, "at least 1"));
        }
        let entry = targets.entry((target.scene_id, target.im_id, target.obj_id)).or_insert(target);
        entry.inst_count = entry.inst_count.max(target.inst_count);
    }
    if targets.is_empty() {
        return Err(FormatError::field(path.display(), "list of targets", "empty", "at least one target"));
    }
    Ok(targets.into_values().collect())
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
/// `place` is the list in messages. An image of an unannotated split may show anything.
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
    }
    Ok(())
}

/// Checks a target list against the annotations: every scene, image and object is there. `place` is the list in messages.
pub fn check_targets(targets: &[Target], place: &str, split: &BopSplit) -> Result<(), FormatError> {
    targets.iter().try_for_each(|t| {
        let place = format!("{place}: scene {} image {} object {}", t.scene_id, t.im_id, t.obj_id);
        check_object(split, [t.scene_id, t.im_id, t.obj_id], ["scene_id", "im_id"], &place)
    })
}

fn check_object(
    split: &BopSplit,
    [scene_id, im_id, obj_id]: [u32; 3],
    fields: [&str; 2],
    place: &str,
) -> Result<(), FormatError> {
    if !split.scene_ids().contains(&scene_id) {
        let expected = format!("a scene of {}: {:?}", split.folder().display(), split.scene_ids());
        return Err(FormatError::field(place, fields[0], scene_id, expected));
    }
    let scene = split.scene(scene_id)?;
    if !scene.image_ids().any(|id| id == im_id) {
        let expected = format!("an image of {}", scene.folder.join("scene_camera.json").display());
        return Err(FormatError::field(place, fields[1], im_id, expected));
    }
    let Ok(annotated) = scene.gt(im_id) else { return Ok(()) };
    if annotated.iter().any(|gt| gt.obj_id == obj_id) {
        return Ok(());
    }
    let mut there: Vec<u32> = annotated.iter().map(|gt| gt.obj_id).collect();
    there.dedup();
    let file = scene.folder.join("scene_gt.json");
    let expected = format!("an object annotated in {} image {im_id}: {there:?}", file.display());
    Err(FormatError::field(place, "obj_id", obj_id, expected))
}

/// Writes either kind of list.
pub fn write_targets<T: Serialize>(path: &Path, targets: &[T]) -> Result<(), FormatError> {
    write_json(path, targets, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_list_is_a_target_list() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("targets.json");
        let entry = |ref_im_id, rot_deg| ReferenceTarget {
            scene_id: 2,
            im_id: 4,
            obj_id: 1,
            ref_scene_id: 101,
            ref_im_id,
            rot_deg,
            overlap: None,
        };
        let list = [entry(0, Some(12.5)), entry(1, None)];
        write_targets(&path, &list).unwrap();
        assert_eq!(read_reference_targets(&path).unwrap(), list);
        let expected = Target { scene_id: 2, im_id: 4, obj_id: 1, inst_count: 1 };
        assert_eq!(read_targets(&path).unwrap(), [expected]);
        let message = read_reference_targets(&folder.path().join("absent.json")).unwrap_err().to_string();
        assert!(message.contains("absent.json"), "{message}");
    }

    #[test]
    fn useless_lists_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("targets.json");
        let zero = r#"[{"scene_id":1,"im_id":0,"obj_id":1,"inst_count":0}]"#;
        for (text, part) in [("[]", "empty"), (zero, "inst_count is 0"), (r#"[{"scene_id":1}]"#, "im_id")] {
            std::fs::write(&path, text).unwrap();
            let message = read_targets(&path).unwrap_err().to_string();
            assert!(message.contains("targets.json") && message.contains(part), "{message}");
        }
    }
}
