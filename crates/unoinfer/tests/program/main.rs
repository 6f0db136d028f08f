//! `unoinfer` as a process.

mod endings;
mod infer;
mod inputs;
mod sam;
mod verify;
