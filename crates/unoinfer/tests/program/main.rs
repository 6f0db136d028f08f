//! `unoinfer` as a process.

mod infer;
mod inputs;
mod sam;
mod verify;
