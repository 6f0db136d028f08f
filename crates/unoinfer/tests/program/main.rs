//! `unoinfer` as a process.

mod absence;
mod endings;
mod infer;
mod inputs;
mod sam;
mod verify;
