//! Judges poses by what both cameras see: surfaces that must coincide, space that must be free, colours that must agree.
//!
//! Each view is a small map of its camera ([`AppearanceView`]); under a pose the surface points of either view are
//! projected into the other's map ([`Agreement`]).

mod agreement;
mod view;

pub use agreement::{Agreement, Detail, SideAgreement};
pub use view::AppearanceView;

#[cfg(test)]
pub(crate) mod tests;
