//! The matcher that is chosen at run time.

use std::path::Path;

use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_infer::PoseEstimator;

use super::{
    Comparison, DinoMatcher, DinoObject, GeometricMatcher, GeometricObject, Matcher, Proposal, SegmentError,
};

/// Any of the matchers.
pub enum AnyMatcher<'a> {
    /// By the pose network's own checkpoint.
    Geometric(GeometricMatcher<'a>),
    /// By DINOv2 weights.
    Dino(Box<DinoMatcher>),
}

/// What one of them keeps of an object.
pub enum AnyObject {
    /// Made by [`AnyMatcher::Geometric`].
    Geometric(Box<GeometricObject>),
    /// Made by [`AnyMatcher::Dino`].
    Dino(DinoObject),
}

impl<'a> AnyMatcher<'a> {
    /// By DINOv2 weights where there are any, else by the pose network's own checkpoint.
    pub fn choose(descriptor: Option<&Path>, estimator: &'a PoseEstimator) -> Result<Self, SegmentError> {
        Ok(match descriptor {
            Some(path) => Self::Dino(Box::new(DinoMatcher::load(path, estimator.backend())?)),
            None => Self::Geometric(GeometricMatcher::new(estimator)?),
        })
    }
}

impl Matcher for AnyMatcher<'_> {
    type Object = AnyObject;

    fn name(&self) -> String {
        match self {
            Self::Geometric(matcher) => matcher.name(),
            Self::Dino(matcher) => matcher.name(),
        }
    }

    fn fingerprint(&self) -> String {
        match self {
            Self::Geometric(matcher) => matcher.fingerprint(),
            Self::Dino(matcher) => matcher.fingerprint(),
        }
    }

    fn instance_score(&self) -> f64 {
        match self {
            Self::Geometric(matcher) => matcher.instance_score(),
            Self::Dino(matcher) => matcher.instance_score(),
        }
    }

    fn knows_absence(&self) -> bool {
        match self {
            Self::Geometric(matcher) => matcher.knows_absence(),
            Self::Dino(matcher) => matcher.knows_absence(),
        }
    }

    fn object(&self, views: &[MaskedView]) -> Result<AnyObject, SegmentError> {
        Ok(match self {
            Self::Geometric(matcher) => AnyObject::Geometric(Box::new(matcher.object(views)?)),
            Self::Dino(matcher) => AnyObject::Dino(matcher.object(views)?),
        })
    }

    fn compare(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&AnyObject],
    ) -> Result<Vec<Vec<Comparison>>, SegmentError> {
        let other = || SegmentError::OtherMatcher { matcher: self.name() };
        match self {
            Self::Geometric(matcher) => {
                let own: Option<Vec<_>> = objects.iter().map(|object| object.geometric()).collect();
                matcher.compare(frame, proposals, &own.ok_or_else(other)?)
            }
            Self::Dino(matcher) => {
                let own: Option<Vec<_>> = objects.iter().map(|object| object.dino()).collect();
                matcher.compare(frame, proposals, &own.ok_or_else(other)?)
            }
        }
    }

    fn recut(
        &self,
        frame: &RgbdFrame,
        mask: &Mask,
        object: &AnyObject,
        t_query_reference: &Pose,
    ) -> Option<Mask> {
        match self {
            Self::Geometric(matcher) => matcher.recut(frame, mask, object.geometric()?, t_query_reference),
            Self::Dino(matcher) => matcher.recut(frame, mask, object.dino()?, t_query_reference),
        }
    }
}

impl AnyObject {
    fn geometric(&self) -> Option<&GeometricObject> {
        match self {
            Self::Geometric(object) => Some(object),
            Self::Dino(_) => None,
        }
    }

    fn dino(&self) -> Option<&DinoObject> {
        match self {
            Self::Dino(object) => Some(object),
            Self::Geometric(_) => None,
        }
    }
}
