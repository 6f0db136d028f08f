//! The classical methods by name.

use super::{AlignCenter, FpfhMac, FpfhRansac, PairEstimator, Ppf, RegistrationError};

/// Names of the classical methods, from the weakest idea to the strongest.
pub const CLASSICAL_METHODS: [&str; 4] = ["aligncenter", "fpfh-ransac", "fpfh-mac", "ppf"];

/// A classical method with its default constants.
pub fn classical_method(name: &str) -> Result<Box<dyn PairEstimator>, RegistrationError> {
    match name {
        "aligncenter" => Ok(Box::new(AlignCenter)),
        "fpfh-ransac" => Ok(Box::new(FpfhRansac::default())),
        "fpfh-mac" => Ok(Box::new(FpfhMac::default())),
        "ppf" => Ok(Box::new(Ppf::default())),
        _ => Err(RegistrationError::Method { name: name.to_owned(), expected: CLASSICAL_METHODS.to_vec() }),
    }
}
