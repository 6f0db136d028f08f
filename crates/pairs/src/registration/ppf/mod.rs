//! Point pair features with voting (Drost, Ulrich, Navab, Ilic: "Model globally, match locally", CVPR 2010). The model is
//! what the reference view shows.

mod clusters;
mod features;
mod voting;

use super::{
    CloudRegistration, RegistrationError,
    surface::{self, Surface},
};
use clusters::heaviest_cluster;
use features::{AlignedPoints, PairTable};
use unopose_core::geometry::Pose;
use voting::vote;

/// Constants of table, voting and clustering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ppf {
    /// Cells along the reference's extent; a cell is also the step of the distances.
    pub cells: f64,
    /// Steps of the full circle, of the normals' angles as of the voted one.
    pub angles: usize,
    /// Every so many query points one is a point of reference.
    pub reference_step: usize,
    /// Poses of one cluster are nearer than this share of the extent, and than one angle step.
    pub cluster_extent: f64,
    /// Distance, in cells, below which a point lies on the other surface.
    pub fit_cells: f32,
}

impl Default for Ppf {
    fn default() -> Self {
        Self { cells: 18.0, angles: 30, reference_step: 3, cluster_extent: 0.1, fit_cells: 1.0 }
    }
}

impl CloudRegistration for Ppf {
    fn name(&self) -> &'static str {
        "ppf"
    }

    fn fingerprint(&self) -> String {
        format!("{self:?}")
    }

    fn register(&self, query: &[[f32; 3]], reference: &[[f32; 3]]) -> Result<(Pose, f64), RegistrationError> {
        let extent = surface::extent(reference, "reference")?;
        surface::extent(query, "query")?;
        let cell = (extent / self.cells) as f32;
        let query = Surface::new(query, cell, "query")?.with_pose()?;
        let reference = Surface::new(reference, cell, "reference")?.with_pose()?;
        let model = AlignedPoints::new(&reference);
        let table = PairTable::new(&model, f64::from(cell), self.angles);
        let poses = vote(&table, &model, &AlignedPoints::new(&query), self.reference_step);
        let angle_deg = 360.0 / self.angles as f64;
        let pose = heaviest_cluster(poses, &reference.center, self.cluster_extent * extent, angle_deg)
            .ok_or(RegistrationError::TooFewMatches { found: 0, minimum: 1 })?;
        Ok((pose, reference.inlier_ratio(&query, &pose.inverse(), self.fit_cells * cell)))
    }
}
