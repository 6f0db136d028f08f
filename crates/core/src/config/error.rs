//! Why a configuration was refused.

use std::{io, path::PathBuf};

/// A configuration file, override or value that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("cannot read configuration {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("no embedded configuration {name:?}, expected one of {}", super::EMBEDDED_NAMES.join(", "))]
    Embedded { name: String },
    #[error("{}:{line}: {message}", path.display())]
    Parse { path: PathBuf, line: usize, message: String },
    #[error("--set {text}: {message}")]
    Override { text: String, message: String },
    #[error("configuration field {field} is {value}, expected {expected}")]
    Range { field: String, value: String, expected: String },
    #[error("cannot write the configuration as TOML: {0}")]
    Serialize(#[from] toml::ser::Error),
}

/// A message of serde about an unknown name, split into the name and the names it would take.
pub(super) struct UnknownName {
    pub name: String,
    pub valid: Vec<String>,
}

impl UnknownName {
    /// Reads "unknown field `x`, expected one of `a`, `b`" and the same about variants.
    pub fn in_message(message: &str) -> Option<Self> {
        if !message.contains("unknown field") && !message.contains("unknown variant") {
            return None;
        }
        let mut quoted = message.split('`').skip(1).step_by(2).map(str::to_owned);
        Some(Self { name: quoted.next()?, valid: quoted.collect() })
    }

    /// "unknown key `stpes`, nearest valid key `steps` (valid: ...)".
    pub fn explain(&self) -> String {
        let mut text = format!("unknown key or value `{}`", self.name);
        if let Some(nearest) = nearest(&self.name, self.valid.iter().map(String::as_str)) {
            text += &format!(", nearest valid: `{nearest}`");
        }
        if !self.valid.is_empty() {
            text += &format!(" (valid here: {})", self.valid.join(", "));
        }
        text
    }
}

/// The candidate most similar to `name`.
pub(super) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::damerau_levenshtein(name, candidate), candidate))
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, candidate)| candidate)
}
