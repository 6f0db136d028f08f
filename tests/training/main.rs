//! Training and estimation as a whole.

mod alternatives;
mod distil;
mod estimator;
mod overfit;
mod run;
