//! Pairs of views as the network's inputs, and the classical registration of such pairs. No tensors.

pub mod appearance;
pub mod data;
pub mod registration;
