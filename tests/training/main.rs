//! Training and estimation as a whole.

mod alternatives;
mod estimator;
mod overfit;
mod run;
