//! `models_info.json`: size and symmetries of every object.

use std::{collections::BTreeMap, path::Path};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use unopose_core::geometry::Pose;

use super::{
    FormatError,
    files::{read_json, write_json},
    numbered::ById,
    symmetry::{ObjectSymmetries, SymmetryAxis},
};

const MM_PER_METRE: f64 = 1000.0;

/// Size and symmetries of an object, metres.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelInfo {
    /// Largest distance between two vertices.
    pub diameter: f64,
    /// Corner of the axis-aligned box with the smallest coordinates.
    pub min: Vector3<f64>,
    /// Sides of that box.
    pub size: Vector3<f64>,
    /// Motions that map the object onto itself.
    pub symmetries: ObjectSymmetries,
}

/// An entry as BOP writes it, millimetres.
#[derive(Serialize, Deserialize)]
struct ModelRecord {
    diameter: f64,
    #[serde(default)]
    min_x: f64,
    #[serde(default)]
    min_y: f64,
    #[serde(default)]
    min_z: f64,
    #[serde(default)]
    size_x: f64,
    #[serde(default)]
    size_y: f64,
    #[serde(default)]
    size_z: f64,
    /// 4x4 row-major.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    symmetries_discrete: Vec<[f64; 16]>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    symmetries_continuous: Vec<AxisRecord>,
}

#[derive(Serialize, Deserialize)]
struct AxisRecord {
    axis: [f64; 3],
    #[serde(default)]
    offset: [f64; 3],
}

/// Reads `models_info.json`, by object id.
pub fn read_models_info(path: &Path) -> Result<BTreeMap<u32, ModelInfo>, FormatError> {
    let ById(records) = read_json::<ById<ModelRecord>>(path)?;
    let check = |(id, record): (u32, ModelRecord)| {
        let place = || format!("{}: object {id}", path.display());
        Ok((id, record.check().map_err(|e| e.within(place()))?))
    };
    records.into_iter().map(check).collect()
}

/// Writes `models_info.json`.
pub fn write_models_info(path: &Path, models: &BTreeMap<u32, ModelInfo>) -> Result<(), FormatError> {
    let records: BTreeMap<u32, ModelRecord> =
        models.iter().map(|(&id, info)| (id, ModelRecord::from(info))).collect();
    write_json(path, &records, true)
}

impl ModelRecord {
    fn check(self) -> Result<ModelInfo, FormatError> {
        let positive = |field: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(FormatError::field("entry", field, value, "a finite number above 0 (mm)")),
        };
        positive("diameter", self.diameter)?;
        // Absent sides are 0.
        for (field, side) in [("size_x", self.size_x), ("size_y", self.size_y), ("size_z", self.size_z)] {
            if side != 0.0 {
                positive(field, side)?;
            }
        }
        let discrete = self.symmetries_discrete.iter().map(|m| {
            let pose = Pose::new(
                Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]),
                Vector3::new(m[3], m[7], m[11]) / MM_PER_METRE,
            );
            let last_row = m[12..15].iter().all(|v| v.abs() < 1e-6) && (m[15] - 1.0).abs() < 1e-6;
            if pose.rotation_defect() < 1e-2 && last_row {
                Ok(pose)
            } else {
                Err(FormatError::field(
                    "entry",
                    "symmetries_discrete",
                    format!("{m:?}"),
                    "a rigid 4x4 matrix",
                ))
            }
        });
        let continuous = self.symmetries_continuous.iter().map(|record| {
            let axis = Vector3::from(record.axis);
            match axis.try_normalize(1e-9) {
                Some(axis) => Ok(SymmetryAxis { axis, offset: Vector3::from(record.offset) / MM_PER_METRE }),
                None => {
                    let value = format!("{:?}", record.axis);
                    Err(FormatError::field(
                        "entry",
                        "symmetries_continuous axis",
                        value,
                        "a vector that is not 0",
                    ))
                }
            }
        });
        Ok(ModelInfo {
            diameter: self.diameter / MM_PER_METRE,
            min: Vector3::new(self.min_x, self.min_y, self.min_z) / MM_PER_METRE,
            size: Vector3::new(self.size_x, self.size_y, self.size_z) / MM_PER_METRE,
            symmetries: ObjectSymmetries {
                discrete: discrete.collect::<Result<_, _>>()?,
                continuous: continuous.collect::<Result<_, _>>()?,
            },
        })
    }
}

impl From<&ModelInfo> for ModelRecord {
    fn from(info: &ModelInfo) -> Self {
        let (min, size) = (info.min * MM_PER_METRE, info.size * MM_PER_METRE);
        let matrix = |pose: &Pose| {
            let (r, t) = (pose.rotation_row_major(), pose.translation * MM_PER_METRE);
            [r[0], r[1], r[2], t.x, r[3], r[4], r[5], t.y, r[6], r[7], r[8], t.z, 0.0, 0.0, 0.0, 1.0]
        };
        let axis =
            |a: &SymmetryAxis| AxisRecord { axis: a.axis.into(), offset: (a.offset * MM_PER_METRE).into() };
        Self {
            diameter: info.diameter * MM_PER_METRE,
            min_x: min.x,
            min_y: min.y,
            min_z: min.z,
            size_x: size.x,
            size_y: size.y,
            size_z: size.z,
            symmetries_discrete: info.symmetries.discrete.iter().map(matrix).collect(),
            symmetries_continuous: info.symmetries.continuous.iter().map(axis).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn millimetres_become_metres_and_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("models_info.json");
        let text = r#"{"7": {"diameter": 200.0, "min_x": -50.0, "size_x": 100.0, "unknown": 1,
            "symmetries_discrete": [[-1,0,0,4, 0,-1,0,0, 0,0,1,0, 0,0,0,1]],
            "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [0, 10, 0]}]}}"#;
        std::fs::write(&path, text).unwrap();
        let models = read_models_info(&path).unwrap();
        let info = &models[&7];
        assert_eq!((info.diameter, info.min.x, info.size.x), (0.2, -0.05, 0.1));
        assert_eq!(info.symmetries.discrete[0].translation, Vector3::new(0.004, 0.0, 0.0));
        assert_eq!(info.symmetries.continuous[0].axis, Vector3::z());
        assert_eq!(info.symmetries.continuous[0].offset, Vector3::new(0.0, 0.01, 0.0));
        write_models_info(&path, &models).unwrap();
        assert_eq!(read_models_info(&path).unwrap(), models);
    }

    #[test]
    fn unusable_entries_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("models_info.json");
        for (entry, part) in [
            (r#"{"diameter": 0}"#, "object 3: entry: diameter is 0"),
            (r#"{"diameter": 1, "symmetries_continuous": [{"axis": [0,0,0]}]}"#, "axis"),
            (r#"{"diameter": 1, "symmetries_discrete": [[1,0,0,0]]}"#, "line 1"),
            (r#"{"size_x": 1}"#, "diameter"),
            (r#"{"diameter": NaN}"#, "3.diameter: invalid type: string \"NaN\""),
            (r#"{"diameter": null}"#, "3.diameter: invalid type: null"),
            (r#"{"diameter": -5}"#, "diameter is -5"),
            (r#"{"diameter": 1, "size_y": -2}"#, "size_y is -2"),
            (
                r#"{"diameter": 1, "symmetries_discrete": [[1,0,0,0, 0,1,0,0, 0,0,-1,0, 0,0,0,1]]}"#,
                "a rigid 4x4",
            ),
            (
                r#"{"diameter": 1, "symmetries_discrete": [[1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]]}"#,
                "a rigid 4x4",
            ),
            (
                r#"{"diameter": 1, "symmetries_continuous": [{"axis": [0,1]}]}"#,
                "3.symmetries_continuous[0].axis",
            ),
            (r#"{"diameter": 1}, "03": {"diameter": 2}"#, "3 is there twice"),
            (r#"{"diameter": 1}, "x": {"diameter": 2}"#, "key \"x\", expected an id"),
        ] {
            std::fs::write(&path, format!(r#"{{"3": {entry}}}"#)).unwrap();
            let message = read_models_info(&path).unwrap_err().to_string();
            assert!(message.contains("models_info.json") && message.contains(part), "{message}");
        }
    }
}
