//! Geometry on plain slices: reference tensors, invariances, timings.

mod fixtures;
mod properties;
mod timing;
