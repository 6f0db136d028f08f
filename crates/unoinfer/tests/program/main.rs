//! `unoinfer` as a process.

mod absence;
mod endings;
mod infer;
mod inputs;
mod pairs;
mod sam;
mod verify;
