//! Constants of the iterations.

/// How distances between matched points count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    PointToPlane,
    /// Generalised ICP.
    PlaneToPlane,
}

/// Constants of the iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IcpSettings {
    pub metric: Metric,
    /// First distance limits that are tried, in extents of the reference; the best result is taken.
    pub first_limits: [f64; 2],
    /// Last distance limit, in extents.
    pub last_limit: f64,
    /// Factor of the limit per iteration.
    pub shrink: f64,
    pub iterations: usize,
    /// Smallest eigenvalue of the normalised normal equations of a direction that is moved in.
    pub min_eigenvalue: f64,
    /// Share of the start's residual that the result has to be below.
    pub gain: f64,
    /// By how many standard errors of a variance the squared residual has to fall: that of n pixels is known up to a share
    /// of about 1 / sqrt(n), so small objects need a clearer gain.
    pub noise: f64,
}

impl IcpSettings {
    pub const POINT_TO_PLANE: Self = Self {
        metric: Metric::PointToPlane,
        first_limits: [0.2, 0.08],
        last_limit: 0.035,
        shrink: 0.85,
        iterations: 24,
        min_eigenvalue: 0.005,
        gain: 0.95,
        noise: 20.0,
    };
    pub const GENERALIZED: Self = Self { metric: Metric::PlaneToPlane, ..Self::POINT_TO_PLANE };
}
