//! Target lists: which instances are to be found, and in which image each one's reference view is.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};

use super::{
    FormatError,
    files::{read_json, write_json},
};

/// An entry of `test_targets_bop19.json`: `inst_count` instances of an object in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Target {
    pub scene_id: u32,
    pub im_id: u32,
    pub obj_id: u32,
    /// 1 where the file does not say, as in lists of references.
    #[serde(default = "one")]
    pub inst_count: u32,
}

fn one() -> u32 {
    1
}

/// An entry of `test_ref_targets_*.json`: a target and the image that shows its reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceTarget {
    pub scene_id: u32,
    pub im_id: u32,
    pub obj_id: u32,
    pub ref_scene_id: u32,
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
