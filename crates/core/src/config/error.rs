//! Why a configuration was refused.

use std::{io, path::PathBuf};

/// A configuration file, override or value that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read configuration {}: {source}", path.display())]
    Read {
        /// The configuration file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// No configuration of this name is compiled in.
    #[error("no embedded configuration {name:?}, expected one of {}", super::EMBEDDED_NAMES.join(", "))]
    Embedded {
        /// The name that was asked for.
        name: String,
    },
    /// The text is no TOML, or has an unknown key or a value of a wrong type.
    #[error("{}:{line}: {message}", path.display())]
    Parse {
        /// The configuration file.
        path: PathBuf,
        /// Line of the mistake, from 1.
        line: usize,
        /// The mistake, with the nearest valid key where a key is unknown.
        message: String,
    },
    /// A `--set` override that cannot be applied.
    #[error("--set {text}: {message}")]
    Override {
        /// The override as it was given, `path=value`.
        text: String,
        /// The mistake, with the nearest valid key where a key is unknown.
        message: String,
    },
    /// A value outside its range.
    #[error("configuration field {field} is {value}, expected {expected}")]
    Range {
        /// Dotted path of the field, or of a key of the official `config.json`.
        field: String,
        /// The value met.
        value: String,
        /// The values that are allowed.
        expected: String,
    },
    /// The tree has no form in TOML.
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
