//! Two clouds with matched features, where registration by features begins.

use unopose_core::geometry::Pose;

use super::{
    RegistrationError,
    fpfh::{fpfh, nearest_features},
    surface::{self, Surface},
};

/// Radius of the descriptors' neighbourhoods, in cells.
const FEATURE_RADIUS: f32 = 5.0;
/// Distance, in cells, below which a point lies on the other surface.
const FIT_CELLS: f32 = 1.5;
/// Cosine of the largest angle between the normals of a match that agrees with a pose.
const NORMAL_COSINE: f32 = 0.7;
/// Fewest matches.
const MIN_MATCHES: usize = 3;

/// Two points with similar features, metres, each in its own camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    pub query: [f32; 3],
    pub reference: [f32; 3],
    pub query_normal: [f32; 3],
    pub reference_normal: [f32; 3],
}

/// Decides in single precision which matches agree with a pose (reference to query camera).
#[derive(Clone, Copy, Debug)]
pub struct InlierTest {
    rows: [[f32; 3]; 3],
    shift: [f32; 3],
}

impl InlierTest {
    pub fn new(t_query_reference: &Pose) -> Self {
        let rows =
            std::array::from_fn(|i| std::array::from_fn(|j| t_query_reference.rotation[(i, j)] as f32));
        Self { rows, shift: t_query_reference.translation.cast::<f32>().into() }
    }

    /// Between the query point and the moved reference point.
    pub fn squared_distance(&self, matched: &Match) -> f32 {
        let at = |i: usize| dot(&self.rows[i], &matched.reference) + self.shift[i] - matched.query[i];
        let d = [at(0), at(1), at(2)];
        dot(&d, &d)
    }

    /// Do the normals point the same way?
    pub fn normals_agree(&self, matched: &Match) -> bool {
        let turned = self.rows.map(|row| dot(&row, &matched.reference_normal));
        dot(&turned, &matched.query_normal) > NORMAL_COSINE
    }

    /// Does a match agree with the pose to `limit` metres?
    pub fn is_inlier(&self, matched: &Match, limit: f32) -> bool {
        self.squared_distance(matched) < limit * limit && self.normals_agree(matched)
    }
}

pub(super) fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The downsampled surfaces and the matches of their FPFH, most similar first.
pub struct FeaturePair {
    pub query: Surface,
    pub reference: Surface,
    pub matches: Vec<Match>,
    /// Side of the voxel grid's cells of both, metres.
    pub cell: f32,
}

impl FeaturePair {
    /// `cells` along the reference's extent; every point is matched with the `nearest` most similar of the other view.
    pub fn new(
        query: &[[f32; 3]],
        reference: &[[f32; 3]],
        cells: f64,
        nearest: usize,
    ) -> Result<Self, RegistrationError> {
        let cell = (surface::extent(reference, "reference")? / cells) as f32;
        surface::extent(query, "query")?;
        let query = Surface::new(query, cell, "query")?.with_pose()?;
        let reference = Surface::new(reference, cell, "reference")?.with_pose()?;
        let [query_features, reference_features] =
            [&query, &reference].map(|surface| fpfh(surface, FEATURE_RADIUS * cell));
        let indices = nearest_features(&query_features, &reference_features, nearest);
        if indices.len() < MIN_MATCHES {
            return Err(RegistrationError::TooFewMatches { found: indices.len(), minimum: MIN_MATCHES });
        }
        let normal = |surface: &Surface, i: usize| surface.normals[i].cast::<f32>().into();
        let matched = |(q, r): (usize, usize)| Match {
            query: query.points[q],
            reference: reference.points[r],
            query_normal: normal(&query, q),
            reference_normal: normal(&reference, r),
        };
        let matches = indices.into_iter().map(matched).collect();
        Ok(Self { query, reference, matches, cell })
    }

    /// Share of the query's points that lie on the moved reference.
    pub fn fitness(&self, t_query_reference: &Pose) -> f64 {
        self.reference.inlier_ratio(&self.query, &t_query_reference.inverse(), FIT_CELLS * self.cell)
    }
}
