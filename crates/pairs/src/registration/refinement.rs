//! What happens to a pose after it was found.

use std::{fmt, str::FromStr};

use unopose_core::geometry::Pose;

use super::{
    RegistrationError,
    icp::{IcpReference, IcpSettings, refine_with},
};

/// A local refinement; it goes at most 30 mm and 15 degrees from its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refinement {
    /// Leaves the pose as it is.
    #[default]
    None,
    /// Point-to-plane ICP.
    Icp,
    /// Generalised ICP.
    Gicp,
}

impl Refinement {
    /// Constants of the iterations, `None` without any.
    pub fn settings(self) -> Option<IcpSettings> {
        match self {
            Self::None => None,
            Self::Icp => Some(IcpSettings::POINT_TO_PLANE),
            Self::Gicp => Some(IcpSettings::GENERALIZED),
        }
    }

    /// The pose (reference to query camera, metres) after refinement with all points of both masked views.
    pub fn apply(self, query: &[[f32; 3]], reference: &[[f32; 3]], start: &Pose) -> Pose {
        match (self.settings(), IcpReference::new(reference)) {
            (Some(settings), Some(reference)) => {
                refine_with(query, &reference, start, &settings).t_query_reference
            }
            _ => *start,
        }
    }

    pub(super) fn fingerprint(self) -> String {
        self.settings().map_or_else(|| "none".into(), |settings| format!("{settings:?}"))
    }
}

impl FromStr for Refinement {
    type Err = RegistrationError;

    fn from_str(name: &str) -> Result<Self, RegistrationError> {
        match name {
            "none" => Ok(Self::None),
            "icp" => Ok(Self::Icp),
            "gicp" => Ok(Self::Gicp),
            _ => Err(RegistrationError::Refinement(name.to_owned())),
        }
    }
}

impl fmt::Display for Refinement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "none",
            Self::Icp => "icp",
            Self::Gicp => "gicp",
        })
    }
}
