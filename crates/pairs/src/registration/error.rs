//! Why two views could not be registered.

/// Why two views could not be registered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegistrationError {
    /// A view has too few points for a surface.
    #[error("the {view} has {points} finite points of a surface, expected at least {minimum}")]
    TooFewPoints {
        /// Query or reference.
        view: &'static str,
        /// Points that are finite and have enough neighbours for a normal.
        points: usize,
        /// Fewest points of a surface.
        minimum: usize,
    },
    /// All points of a view coincide.
    #[error("the {view}'s points all lie within {extent} m, expected an object")]
    NoExtent {
        /// Query or reference.
        view: &'static str,
        /// Twice the distance to the mean that 95 % of the points stay below, metres.
        extent: f64,
    },
    /// The features of the two views have too little in common.
    #[error("{found} matches of features between query and reference, expected at least {minimum}")]
    TooFewMatches {
        /// Matches of features.
        found: usize,
        /// Fewest matches that determine a pose.
        minimum: usize,
    },
    /// No pose agrees with enough matches.
    #[error(
        "no rigid motion agrees with the matches: the best explains {inliers}, expected at least {minimum}"
    )]
    NoConsensus {
        /// Matches that agree with the best pose.
        inliers: usize,
        /// Fewest matches of an accepted pose.
        minimum: usize,
    },
    /// A plane or a sphere, which a whole family of poses maps onto itself.
    #[error("the surface leaves {unconstrained} directions of motion open: a plane or a sphere has no pose")]
    Degenerate {
        /// Directions of motion, of six, that map the surface onto itself.
        unconstrained: usize,
    },
    /// No refinement has this name.
    #[error("unknown refinement {0:?}, expected none, icp or gicp")]
    Refinement(String),
    /// No method has this name.
    #[error("unknown method {name:?}, expected unopose or one of {}", .expected.join(", "))]
    Method {
        /// The name met.
        name: String,
        /// Names of the classical methods.
        expected: Vec<&'static str>,
    },
    /// The error of an estimator that is implemented outside this crate.
    #[error(transparent)]
    Estimator(Box<dyn std::error::Error + Send + Sync>),
}
