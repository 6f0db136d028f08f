//! `unoinfer` as a process.

mod infer;
mod sam;
mod verify;
