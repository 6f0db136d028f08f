//! The programs as processes.

mod infer;
mod sam;
mod train;
mod verify;
