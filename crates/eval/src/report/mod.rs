//! Figures and tables: curves over training steps (SVG), poses and masks drawn onto images (PNG), text tables.

mod curves;
mod error;
pub mod overlay;
mod table;

pub use curves::{Curve, Panel, smoothed, write_curves};
pub use error::ReportError;
pub use table::Table;
