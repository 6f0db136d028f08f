//! Ref. AlignCenter: the rotation of the reference view with the shift between the centres, the baseline of all methods
//! (section "Comparison with existing methods").

use nalgebra::{Matrix3, Vector3};
use unopose_core::geometry::Pose;

use super::{
    CloudRegistration, RegistrationError,
    surface::{finite, vector},
};

/// Moves the reference's mean point onto the query's.
#[derive(Clone, Copy, Debug, Default)]
pub struct AlignCenter;

impl CloudRegistration for AlignCenter {
    fn name(&self) -> &'static str {
        "aligncenter"
    }

    fn fingerprint(&self) -> String {
        "mean of all points".into()
    }

    fn register(&self, query: &[[f32; 3]], reference: &[[f32; 3]]) -> Result<(Pose, f64), RegistrationError> {
        let shift = mean(query, "query")? - mean(reference, "reference")?;
        Ok((Pose::new(Matrix3::identity(), shift), 1.0))
    }
}

fn mean(points: &[[f32; 3]], view: &'static str) -> Result<Vector3<f64>, RegistrationError> {
    let points = finite(points);
    if points.is_empty() {
        return Err(RegistrationError::TooFewPoints { view, points: 0, minimum: 1 });
    }
    Ok(points.iter().map(vector).sum::<Vector3<f64>>() / points.len() as f64)
}
