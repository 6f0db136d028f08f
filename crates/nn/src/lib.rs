//! The network on tensors: devices, layers, weights in files, losses.

pub mod checkpoint;
pub mod device;
pub mod loss;
pub mod model;
