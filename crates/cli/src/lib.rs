//! What the programs `unotrain` and `unoinfer` share.

mod device;

pub use device::DeviceOption;

use std::io::{ErrorKind, Write as _};

/// Prints a long text. A reader that has seen enough (`| head`) is no error.
pub fn print_text(text: &str) -> std::io::Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}
