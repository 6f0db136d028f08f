//! From a file (or an embedded configuration) to a checked [`Config`].

use std::{ops::Range, path::Path};

use crate::files::read_text;

use super::{Config, ConfigError, error::UnknownName, overrides, validate};

/// Bytes of the largest configuration.
pub(super) const MAX_CONFIG: u64 = 16 << 20;

/// Names accepted by [`Config::embedded`].
pub const EMBEDDED_NAMES: [&str; unopose_configs::ALL.len()] = {
    let mut names = [""; unopose_configs::ALL.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = unopose_configs::ALL[i].0;
        i += 1;
    }
    names
};

impl Config {
    /// Reads `path`, applies the overrides (`"train.steps=2000"`) and checks all ranges.
    pub fn load(path: &Path, overrides: &[String]) -> Result<Self, ConfigError> {
        let text = read_text(path, MAX_CONFIG)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text, path, overrides)
    }

    /// [`Self::load`] of a configuration that is compiled in: `geo`, `unopose` or `smoke`.
    pub fn embedded(name: &str, overrides: &[String]) -> Result<Self, ConfigError> {
        let Some((_, text)) = unopose_configs::ALL.iter().find(|(known, _)| *known == name) else {
            return Err(ConfigError::Embedded { name: name.to_owned() });
        };
        Self::from_toml(text, Path::new(&format!("configs/{name}.toml")), overrides)
    }

    /// Parses `text`; `path` is only for messages.
    pub fn from_toml(text: &str, path: &Path, overrides: &[String]) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text).map_err(|error| explain(text, path, &error))?;
        let config = overrides::apply(config, overrides)?;
        validate::validate(&config)?;
        Ok(config)
    }

    /// The complete tree, defaults included.
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        Ok(toml::to_string(self)?)
    }
}

fn explain(text: &str, path: &Path, error: &toml::de::Error) -> ConfigError {
    let span = error.span().unwrap_or(0..text.len());
    let unknown = UnknownName::in_message(error.message());
    let offset = unknown.as_ref().and_then(|u| offset_of_key(text, &span, &u.name)).unwrap_or(span.start);
    let line = 1 + text[..offset].matches('\n').count();
    let message = unknown.map_or_else(|| error.message().to_owned(), |u| u.explain());
    ConfigError::Parse { path: path.to_owned(), line, message }
}

/// Where `key` is written. Tagged enums report the span of their whole table, so the key is searched from there on.
fn offset_of_key(text: &str, span: &Range<usize>, key: &str) -> Option<usize> {
    let from = text.get(..span.start)?.rfind('\n').map_or(0, |i| i + 1);
    let is_name = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
    text[from..]
        .match_indices(key)
        .map(|(i, _)| from + i)
        .find(|&i| !text[..i].ends_with(is_name) && !text[i + key.len()..].starts_with(is_name))
}
