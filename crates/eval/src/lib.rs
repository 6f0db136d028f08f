//! Scores of poses and masks from anywhere (VSD, MSSD, MSPD, COCO) and the figures and tables that show them. No tensors.

pub mod metrics;
pub mod report;
