//! What the programs share: printing, and the device option.

#[cfg(feature = "device")]
mod device;

#[cfg(feature = "device")]
pub use device::DeviceOption;

use std::io::{ErrorKind, Write};

/// Prints a line to standard output. A reader that has seen enough (`| head`) neither ends the program nor is reported.
#[macro_export]
macro_rules! say {
    ($($part:tt)*) => { $crate::print_text(&format!("{}\n", format_args!($($part)*))) };
}

/// Prints a line to standard error, which may be closed as well.
#[macro_export]
macro_rules! tell {
    ($($part:tt)*) => { $crate::print_note(&format!("{}\n", format_args!($($part)*))) };
}

/// Prints text to standard output: the one place that does. A full disk behind it ends the program with an error.
pub fn print_text(text: &str) {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            print_note(&format!("error: standard output: {error}\n"));
            std::process::exit(1)
        }
        _ => {}
    }
}

/// Prints text to standard error; there is nowhere left to say that it cannot be written.
pub fn print_note(text: &str) {
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}
