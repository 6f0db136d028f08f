//! What needs no tensors: geometry, files, pairs, scores.

mod architecture;
mod config_files;
mod doctor;
mod eval_oracle;
mod fixtures;
mod formats_dev;
mod geometry_fixtures;
mod geometry_properties;
mod geometry_timing;
mod pairs;
mod timing;
