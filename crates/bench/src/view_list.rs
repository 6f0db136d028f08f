//! Lists of pairs of views with known relative poses.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use serde::Deserialize;
use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::formats::{FormatError, files::read_json};
use unopose_infer::{ViewFiles, ViewRole};
use unopose_segment::{AnyMatcher, Matcher as _, SegmentError, UnoSeg};

use super::BenchError;

/// What finds the objects of the references in the queries.
pub type OwnMasks<'a> = UnoSeg<'a, AnyMatcher<'a>>;

/// An entry of a list of pairs. Further fields are left alone.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct ListedPair {
    /// Name of the object: its masks are `mask_OBJECT.png`.
    pub object: String,
    /// Folders of the views, beside the list.
    pub reference: String,
    pub query: String,
    /// With a `+` when nothing that is visible fixes the rotation, so that only the shape counts.
    #[serde(default)]
    pub symmetry: String,
    #[serde(rename = "T_query_reference")]
    t_query_reference: ListedPose,
}

#[derive(Clone, Debug, Deserialize)]
struct ListedPose {
    /// Row by row.
    #[serde(rename = "R")]
    rotation: [f64; 9],
    /// Metres.
    t: [f64; 3],
}

impl ListedPair {
    fn truth(&self, list: &Path) -> Result<Pose, FormatError> {
        let ListedPose { rotation, t } = &self.t_query_reference;
        let pose = Pose::new(nalgebra::Matrix3::from_row_slice(rotation), (*t).into());
        if pose.rotation_defect() < 1e-3 && t.iter().all(|x| x.is_finite()) {
            return Ok(pose);
        }
        let field = format!("T_query_reference of {} in {}", self.object, self.query);
        Err(FormatError::field(list.display(), field, format!("{rotation:?} {t:?}"), "a rotation and metres"))
    }
}

/// The pairs of a list, their views read on demand and kept.
pub(super) struct PairViews<'a> {
    root: PathBuf,
    listed: Vec<(ListedPair, Pose)>,
    known: BTreeMap<(String, String, bool), (RgbdFrame, Mask)>,
    own_masks: Option<&'a OwnMasks<'a>>,
    /// By the pair's place in the list.
    found: BTreeMap<usize, Result<Mask, String>>,
}

/// A pair with its views and the true pose, reference to query camera.
pub(super) struct ViewPair {
    pub listed: ListedPair,
    pub truth: Pose,
    pub reference: (RgbdFrame, Mask),
    pub query: RgbdFrame,
    /// The listed mask or the one that is found; why there is none.
    pub query_mask: Result<Mask, String>,
}

impl<'a> PairViews<'a> {
    /// Reads and checks the list.
    pub fn open(list: &Path, own_masks: Option<&'a OwnMasks<'a>>) -> Result<Self, FormatError> {
        let pairs: Vec<ListedPair> = read_json(list)?;
        if pairs.is_empty() {
            return Err(FormatError::field(list.display(), "pairs", "none", "at least one"));
        }
        let with_truth = |pair: ListedPair| pair.truth(list).map(|truth| (pair, truth));
        Ok(Self {
            root: list.parent().unwrap_or(Path::new(".")).to_owned(),
            listed: pairs.into_iter().map(with_truth).collect::<Result<_, _>>()?,
            known: BTreeMap::new(),
            own_masks,
            found: BTreeMap::new(),
        })
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.listed.len()
    }

    /// A pair by its place in the list.
    pub fn pair(&mut self, index: usize) -> Result<ViewPair, BenchError> {
        let (listed, truth) = self.listed[index].clone();
        let (query, mask) = self.get(&listed.query, &listed.object, ViewRole::Query)?;
        let reference = self.get(&listed.reference, &listed.object, ViewRole::Reference)?;
        let query_mask = match (self.own_masks, self.found.get(&index)) {
            (None, _) => Ok(mask),
            (Some(_), Some(found)) => found.clone(),
            (Some(own_masks), None) => {
                let found = find(own_masks, &reference, &query, &listed.query)?;
                self.found.insert(index, found.clone());
                found
            }
        };
        Ok(ViewPair { listed, truth, reference, query, query_mask })
    }

    fn get(&mut self, folder: &str, object: &str, role: ViewRole) -> Result<(RgbdFrame, Mask), FormatError> {
        let key = (folder.to_owned(), object.to_owned(), role == ViewRole::Reference);
        if let Some(view) = self.known.get(&key) {
            return Ok(view.clone());
        }
        let files = ViewFiles::in_folder(&self.root.join(folder), &[object])?;
        let view = files.read_as(role, None)?;
        let mask = view.masks.into_iter().next().unwrap_or_else(|| Mask::empty(0, 0));
        Ok(self.known.entry(key).or_insert((view.frame, mask)).clone())
    }
}

/// The best mask of the reference's object in the query; why there is none.
fn find(
    own_masks: &OwnMasks<'_>,
    (frame, mask): &(RgbdFrame, Mask),
    query: &RgbdFrame,
    name: &str,
) -> Result<Result<Mask, String>, BenchError> {
    let object = own_masks.matcher.object(&[MaskedView { frame, mask }])?;
    match own_masks.instances(query, &object, name) {
        Ok(found) => {
            Ok(found.found.into_iter().next().map(|best| best.mask.mask).ok_or_else(|| "no mask".into()))
        }
        Err(error @ SegmentError::NotFound { .. }) => Ok(Err(error.to_string())),
        Err(error) => Err(error.into()),
    }
}
