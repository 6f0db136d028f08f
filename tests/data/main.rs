//! Files, pairs and scores.

mod architecture;
mod config_files;
mod eval_oracle;
mod fixtures;
mod formats_dev;
mod pairs;
mod timing;
