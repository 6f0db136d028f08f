//! Why two views could not be registered.

/// Error of the `registration` room.
#[derive(Debug, thiserror::Error)]
pub enum RegistrationError {
    #[error("the {view} has {points} finite points of a surface, expected at least {minimum}")]
    TooFewPoints { view: &'static str, points: usize, minimum: usize },
    #[error("the {view}'s points all lie within {extent} m, expected an object")]
    NoExtent { view: &'static str, extent: f64 },
    #[error("{found} matches of features between query and reference, expected at least {minimum}")]
    TooFewMatches { found: usize, minimum: usize },
    #[error(
        "no rigid motion agrees with the matches: the best explains {inliers}, expected at least {minimum}"
    )]
    NoConsensus { inliers: usize, minimum: usize },
    #[error("the surface leaves {open} directions of motion open: a plane or a sphere has no pose")]
    Degenerate { open: usize },
    #[error("unknown refinement {0:?}, expected none, icp or gicp")]
    Refinement(String),
    #[error("unknown method {name:?}, expected unopose or one of {}", .expected.join(", "))]
    Method { name: String, expected: Vec<&'static str> },
    /// The reason of an estimator from outside of this room.
    #[error(transparent)]
    Estimator(Box<dyn std::error::Error + Send + Sync>),
}
