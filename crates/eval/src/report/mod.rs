//! Figures and tables: training curves (SVG), poses drawn onto images (PNG), text tables, error messages.

mod curves;
mod error;
pub mod overlay;
mod table;

pub use curves::{Curve, Panel, smoothed, write_curves};
pub use error::ReportError;
pub use table::Table;
