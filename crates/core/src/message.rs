//! Errors with their causes in one line.

use std::error::Error;

/// The message and those causes that it does not contain already, the outermost first.
pub fn explain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let message = cause.to_string();
        if !text.contains(&message) {
            text = format!("{text}: {message}");
        }
        next = cause.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct Layer {
        text: &'static str,
        source: Option<Box<Layer>>,
    }

    #[test]
    fn a_cause_is_told_once() {
        let inner = Layer { text: "no such file", source: None };
        let middle = Layer { text: "a.json: no such file", source: Some(inner.into()) };
        let outer = Layer { text: "cannot start", source: Some(middle.into()) };
        assert_eq!(explain(&outer), "cannot start: a.json: no such file");
    }
}
