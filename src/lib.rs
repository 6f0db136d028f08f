//! One-reference 6-DoF pose estimation of unseen objects (UNOPose, CVPR 2025): training and inference.

pub mod checkpoint;
pub mod config;
pub mod data;
pub mod device;
pub mod eval;
pub mod formats;
pub mod frame;
pub mod geometry;
pub mod infer;
pub mod loss;
pub mod mesh;
pub mod model;
pub mod render;
pub mod report;
pub mod synth;
pub mod train;
