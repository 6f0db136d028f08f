//! Training and estimation as a whole.

mod estimator;
mod overfit;
mod run;
