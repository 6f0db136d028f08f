//! One finding: what was looked at, what was measured, what to do.

use std::{collections::BTreeMap, fmt};

use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// As it should be.
    Ok,
    /// Possible, but more often a mistake: a person should look.
    Look,
    /// A pose from this view would be wrong.
    Wrong,
}

/// What was looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Check {
    /// Can the files be read, and do their sizes agree?
    Images,
    /// Intrinsics against the image: field of view, principal point, pixel shape.
    Camera,
    /// Distance and extent of the masked object: the unit of depth.
    Unit,
    /// Share of the mask without depth.
    Depth,
    /// Number of measured points against what the network samples.
    Points,
    /// Clipped or dark colours in the mask.
    Exposure,
    /// Shift between the edges of colour and of depth.
    Alignment,
    /// The mask's border against the borders of the surface in the depth image.
    Mask,
    /// Sizes of the object in reference and query.
    Pair,
    /// Measured distance against the annotated pose.
    Annotation,
}

/// What one check says about one view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub check: Check,
    /// How bad it is.
    pub level: Level,
    /// What was measured, by name; the name ends with the unit (`_m`, `_px`, `_deg`) unless it is a share or a ratio.
    pub values: BTreeMap<&'static str, f64>,
    /// What was found, in words.
    pub text: String,
    /// What to do about it; empty when nothing has to be done.
    pub advice: String,
}

impl Finding {
    /// A finding without values and advice.
    pub fn new(check: Check, level: Level, text: impl Into<String>) -> Self {
        Self { check, level, values: BTreeMap::new(), text: text.into(), advice: String::new() }
    }

    pub(crate) fn with_values<const N: usize>(mut self, values: [(&'static str, f64); N]) -> Self {
        self.values.extend(values);
        self
    }

    /// Advice for findings that are not ok.
    pub(crate) fn advise(mut self, advice: impl Into<String>) -> Self {
        if self.level != Level::Ok {
            self.advice = advice.into();
        }
        self
    }
}

impl Level {
    /// `Look` from the first limit on, `Wrong` from the second.
    pub(crate) fn of(value: f64, [look, wrong]: [f64; 2]) -> Self {
        match value {
            v if v >= wrong => Self::Wrong,
            v if v >= look => Self::Look,
            _ => Self::Ok,
        }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Look => "look",
            Self::Wrong => "wrong",
        })
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Images => "images",
            Self::Camera => "camera",
            Self::Unit => "unit",
            Self::Depth => "depth",
            Self::Points => "points",
            Self::Exposure => "exposure",
            Self::Alignment => "alignment",
            Self::Mask => "mask",
            Self::Pair => "pair",
            Self::Annotation => "annotation",
        })
    }
}

/// One line, and a second one with the advice where there is some.
impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<5}  {:<10}  {}", self.level, self.check, self.text)?;
        if !self.advice.is_empty() {
            write!(f, "\n{:19}{}", "", self.advice)?;
        }
        Ok(())
    }
}
