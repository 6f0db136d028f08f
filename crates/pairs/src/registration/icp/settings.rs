//! Constants of the iterations.

/// How distances between matched points count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Distance across the tangent plane of the reference.
    PointToPlane,
    /// Generalised ICP.
    PlaneToPlane,
}

/// Constants of the iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IcpSettings {
    pub(super) metric: Metric,
    /// First distance limits that are tried, in extents of the reference; the best result is taken.
    pub(super) first_limits: [f64; 2],
    /// Last distance limit, in extents.
    pub(super) last_limit: f64,
    /// Factor of the limit per iteration.
    pub(super) shrink: f64,
    pub(super) iterations: usize,
    /// Smallest eigenvalue of the normalised normal equations of a direction that is moved in.
    pub(super) min_eigenvalue: f64,
    /// Share of the start's residual that the result has to be below.
    pub(super) gain: f64,
    /// By how many standard errors of a variance the squared residual has to fall: that of n pixels is known up to a share
    /// of about 1 / sqrt(n), so small objects need a clearer gain.
    pub(super) noise: f64,
    /// Whether colours count where both views have them.
    pub(super) photometric: bool,
}

impl IcpSettings {
    /// Point-to-plane ICP.
    pub(crate) const POINT_TO_PLANE: Self = Self {
        metric: Metric::PointToPlane,
        first_limits: [0.2, 0.08],
        last_limit: 0.035,
        shrink: 0.85,
        iterations: 24,
        min_eigenvalue: 0.005,
        gain: 0.95,
        noise: 20.0,
        photometric: false,
    };
    /// Generalised ICP.
    pub(crate) const GENERALIZED: Self = Self { metric: Metric::PlaneToPlane, ..Self::POINT_TO_PLANE };

    /// The same with a photometric term besides the distances.
    pub fn colored(self) -> Self {
        Self { photometric: true, ..self }
    }
}
