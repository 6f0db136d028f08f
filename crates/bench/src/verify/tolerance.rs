//! How far a computed tensor may be from the stored one.

use std::{collections::BTreeMap, path::Path};

use serde::Deserialize;
use unopose_nn::device::DeviceChoice;

use super::VerifyError;

/// Bound of one tensor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub(crate) enum Tolerance {
    /// Largest absolute difference; 0: equal.
    Absolute(f64),
    /// For gradients: L2 norm of the difference relative to the stored norm, and cosine between both.
    Direction { relative_l2: f64, cosine: f64 },
}

/// Bounds by tensor name. A name may hold `*` for any text; of several that match the one with the most other
/// characters counts.
#[derive(Clone, Debug)]
pub struct Tolerances {
    given: BTreeMap<String, Tolerance>,
    /// Of the backend, where it computes less exactly.
    backend: BTreeMap<String, Tolerance>,
    built_in: BTreeMap<String, Tolerance>,
}

/// Of computed floats that no entry names: the fixtures' unit tolerance.
const UNIT: f64 = 1e-5;

impl Tolerances {
    /// The built-in bounds (`src/verify/tolerances.json`).
    pub fn built_in() -> Self {
        let built_in = serde_json::from_str(include_str!("tolerances.json")).unwrap_or_default();
        Self { given: BTreeMap::new(), backend: BTreeMap::new(), built_in }
    }

    /// The built-in bounds with those of a JSON file (`{"pred_t": 1e-5, "grad.*": {"relative_l2": 0.05, "cosine":
    /// 0.999}}`) before them.
    pub fn with_file(path: &Path) -> Result<Self, VerifyError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| VerifyError::Read { path: path.to_owned(), source })?;
        let error = |message: String| VerifyError::Tolerances { path: path.to_owned(), message };
        let given: BTreeMap<String, Tolerance> = serde_json::from_str(&text).map_err(|e| {
            error(format!(
                "{e}; expected tensor names with numbers, or with {{\"relative_l2\": x, \"cosine\": y}}"
            ))
        })?;
        let usable = |t: &Tolerance| match *t {
            Tolerance::Absolute(bound) => bound >= 0.0,
            Tolerance::Direction { relative_l2, cosine } => relative_l2 >= 0.0 && cosine <= 1.0,
        };
        if let Some((name, bound)) = given.iter().find(|(_, t)| !usable(t)) {
            return Err(error(format!("{name} is {bound:?}, expected bounds of at least 0")));
        }
        Ok(Self { given, ..Self::built_in() })
    }

    /// With the bounds of a backend before the built-in ones. CUDA's are wider (`src/verify/tolerances-cuda.json`): the
    /// factors of its products are rounded to tf32, 11 bits.
    pub fn for_backend(self, backend: DeviceChoice) -> Self {
        let text = match backend {
            DeviceChoice::Cuda => include_str!("tolerances-cuda.json"),
            _ => "{}",
        };
        Self { backend: serde_json::from_str(text).unwrap_or_default(), ..self }
    }

    /// The bound of a tensor; integers without an entry must be equal.
    pub(super) fn of(&self, name: &str, integer: bool) -> Tolerance {
        let fallback = if integer { 0.0 } else { UNIT };
        best(&self.given, name)
            .or_else(|| best(&self.backend, name))
            .or_else(|| best(&self.built_in, name))
            .unwrap_or(Tolerance::Absolute(fallback))
    }
}

fn best(entries: &BTreeMap<String, Tolerance>, name: &str) -> Option<Tolerance> {
    let exact = entries.get(name).copied();
    exact.or_else(|| {
        let fitting = entries.iter().filter(|(pattern, _)| matches(pattern, name));
        fitting.max_by_key(|(pattern, _)| pattern.len()).map(|(_, &tolerance)| tolerance)
    })
}

/// Whether `name` is `pattern` with its stars replaced by any text.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let Some(mut rest) = name.strip_prefix(parts.next().unwrap_or("")) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((last, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        match rest.find(part) {
            Some(at) => rest = &rest[at + part.len()..],
            None => return false,
        }
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_specific_entry_counts() {
        let t = Tolerances::built_in();
        assert!(!t.built_in.is_empty());
        assert_eq!(t.of("pred_t", false), Tolerance::Absolute(6e-6));
        assert_eq!(t.of("fps_idx_m", true), Tolerance::Absolute(0.0));
        let gradient = Tolerance::Direction { relative_l2: 5e-2, cosine: 0.999 };
        assert_eq!(t.of("grad.coarse_point_matching.bg_token", false), gradient);
        let zero =
            "grad.fine_point_matching.transformers.7.sparse_layer.layers.0.attention.attention.proj_k.bias";
        assert!(matches!(t.of(zero, false), Tolerance::Absolute(_)));
        let dense = "grad.fine_point_matching.transformers.0.dense_layer.attention.attention.proj_k.bias";
        assert_eq!(t.of(dense, false), gradient);
    }

    #[test]
    fn cuda_has_wider_bounds_of_its_own() {
        let [flex, cuda] =
            [DeviceChoice::Flex, DeviceChoice::Cuda].map(|choice| Tolerances::built_in().for_backend(choice));
        assert_eq!(flex.of("pred_R", false), Tolerance::Absolute(1e-5));
        assert_eq!(cuda.of("pred_R", false), Tolerance::Absolute(1e-4));
        // What no product enters keeps its bound, and what is zero in theory stays near zero.
        assert_eq!(cuda.of("fps_idx_m", true), Tolerance::Absolute(0.0));
        let zero = "grad.geo_embedding.proj_d.bias";
        assert_eq!(cuda.of(zero, false), Tolerance::Absolute(1e-4));
        assert!(matches!(cuda.of("grad.geo_embedding.proj_d.weight", false), Tolerance::Direction { .. }));
    }

    #[test]
    fn stars_stand_for_any_text() {
        assert!(matches("a*c*e", "abcde") && matches("*", "") && matches("x", "x") && matches("a*", "a"));
        assert!(!matches("a*c", "ab") && !matches("x", "xy") && !matches("ab*b", "ab"));
    }
}
