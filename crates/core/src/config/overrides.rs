//! `--set a.b=c` on top of a configuration file.

use serde::Deserialize as _;
use toml::{Table, Value};

use super::{
    Config, ConfigError,
    error::{UnknownName, nearest},
};

/// Applies `path=value` to every given default. The value is TOML; what does not parse as TOML is a string.
pub(super) fn apply(config: Config, overrides: &[String]) -> Result<Config, ConfigError> {
    overrides.iter().try_fold(config, |config, text| {
        apply_one(&config, text).map_err(|message| ConfigError::Override { text: text.clone(), message })
    })
}

fn apply_one(config: &Config, text: &str) -> Result<Config, String> {
    let (path, value) = text.split_once('=').ok_or("expected path=value, for example train.steps=2000")?;
    let keys: Vec<&str> = path.trim().split('.').collect();
    let [parents @ .., leaf] = keys.as_slice() else { return Err("the path is empty".into()) };
    let mut tree = Table::try_from(config).map_err(|e| e.to_string())?;
    let mut table = &mut tree;
    for key in parents {
        let valid: Vec<String> = table.keys().cloned().collect();
        table = match table.get_mut(*key) {
            Some(Value::Table(inner)) => inner,
            Some(_) => return Err(format!("`{key}` is a value, it has no keys")),
            None => {
                let near = nearest(key, valid.iter().map(String::as_str)).unwrap_or("");
                return Err(format!(
                    "unknown key `{key}`, nearest valid: `{near}` (valid here: {})",
                    valid.join(", ")
                ));
            }
        };
    }
    let is_text = matches!(table.get(*leaf), Some(Value::String(_)));
    let mut value = parse_value(value.trim(), is_text);
    if let (Some(Value::Float(_)), Value::Integer(whole)) = (table.get(*leaf), &value) {
        value = Value::Float(*whole as f64);
    }
    table.insert((*leaf).to_owned(), value);
    Config::deserialize(tree).map_err(|e| match UnknownName::in_message(e.message()) {
        Some(unknown) => unknown.explain(),
        None => e.message().to_owned(),
    })
}

fn parse_value(text: &str, is_text: bool) -> Value {
    let parsed = toml::from_str::<Table>(&format!("value = {text}")).ok().and_then(|mut t| t.remove("value"));
    match parsed {
        Some(value @ Value::String(_)) => value,
        Some(value) if !is_text => value,
        _ => Value::String(text.to_owned()),
    }
}
