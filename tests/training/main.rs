//! Training and estimation as a whole.

mod alternatives;
mod distil;
mod estimator;
mod kills;
mod overfit;
mod proposals;
mod run;
mod small_runs;
