//! The configuration tree as TOML in which comments explain every key.
//!
//! The text is that of the serialiser; comments are inserted before the lines of its keys. A comment says what the doc
//! comment of the field says, what is allowed and what the default is.

use std::collections::BTreeMap;

use toml::de::{DeTable, DeValue};

use super::{
    Config, ConfigError, SynthConfig,
    schema::{ConfigSchema, SchemaKey, join},
    validate::{Rule, rules},
};

/// Longest line of a comment, characters.
const WIDTH: usize = 100;

impl Config {
    /// The complete tree with the meaning, unit, allowed values and default of every key as comments. It reads back as the
    /// same configuration.
    pub fn to_commented_toml(&self) -> Result<String, ConfigError> {
        Ok(commented(&self.to_toml()?, &rules(self), &Self::default().to_toml()?))
    }
}

impl SynthConfig {
    /// [`Config::to_commented_toml`] of a configuration file that has a `[synth]` part only.
    pub fn to_commented_toml(&self) -> Result<String, ConfigError> {
        let text = toml::to_string(&BTreeMap::from([("synth", self)]))?;
        let tree = Config { synth: self.clone(), ..Config::default() };
        Ok(commented(&text, &rules(&tree), &Config::default().to_toml()?))
    }
}

/// Where a key is written.
struct Written<'t> {
    /// Offset of its line.
    line: usize,
    /// The value as it is written; empty for a table.
    value: &'t str,
}

/// `text`, which holds whole tables of the tree, with comments.
fn commented(text: &str, rules: &[Rule], default_text: &str) -> String {
    let (written, defaults) = (written_keys(text), written_keys(default_text));
    let value = |path: &str| written.get(path).map(|key| key.value);
    let schema = ConfigSchema::new();
    let keys =
        schema.keys(&|path, form| value(path).is_some_and(|word| word.trim_matches(['"', '\'']) == form));
    let mut blocks: Vec<(usize, bool, String)> = Vec::new();
    for key in keys {
        let comment = comment(&key, rules, defaults.get(&key.path).map(|default| default.value));
        let name = key.path.rsplit('.').next().unwrap_or_default();
        let parent = key.path.strip_suffix(name).unwrap_or_default().trim_end_matches('.');
        match (written.get(&key.path), written.get(parent)) {
            (Some(Written { line: 0, .. }), _) => blocks.push((0, true, comment)),
            // The serialiser sets tables apart itself.
            (Some(Written { line, value: "" }), _) => blocks.push((*line, true, comment)),
            (Some(Written { line, .. }), _) => blocks.push((*line, true, format!("\n{comment}"))),
            // A key without a value stands first in its table.
            (None, Some(table)) => {
                let after_header =
                    text[table.line..].find('\n').map_or(text.len(), |end| table.line + end + 1);
                blocks.push((after_header, false, format!("\n{comment}# {name} = \"...\"\n")));
            }
            (None, None) => {}
        }
    }
    blocks.sort_by_key(|(line, has_value, _)| (*line, *has_value));
    let (mut out, mut end) = (String::with_capacity(8 * text.len()), 0);
    for (line, _, block) in blocks {
        out += &text[end..line];
        out += &block;
        end = line;
    }
    out + &text[end..]
}

/// All keys by their paths.
fn written_keys(text: &str) -> BTreeMap<String, Written<'_>> {
    fn collect<'t>(
        text: &'t str,
        table: &DeTable<'_>,
        parent: &str,
        keys: &mut BTreeMap<String, Written<'t>>,
    ) {
        for (key, value) in table {
            let path = join(parent, key.get_ref());
            let line = text[..key.span().start].rfind('\n').map_or(0, |end| end + 1);
            let mut written = Written { line, value: "" };
            match value.get_ref() {
                DeValue::Table(inner) => collect(text, inner, &path, keys),
                _ => written.value = &text[value.span()],
            }
            keys.insert(path, written);
        }
    }
    let mut keys = BTreeMap::new();
    // The text comes from the serialiser: there is nothing to recover from.
    let (root, _) = DeTable::parse_recoverable(text);
    collect(text, root.get_ref(), "", &mut keys);
    keys
}

/// The comment lines of a key. `default` is empty for a table.
fn comment(key: &SchemaKey<'_>, rules: &[Rule], default: Option<&str>) -> String {
    let mut lines = String::new();
    wrap(key.text, "# ", "# ", &mut lines);
    if default == Some("") {
        return lines;
    }
    let choices = key.choices();
    for choice in &choices {
        wrap(&format!("{:?}: {}", choice.name, choice.text), "#   ", "#     ", &mut lines);
    }
    let allowed = if choices.is_empty() { allowed(key, rules) } else { "one of these".to_owned() };
    let default = match (key.required, default) {
        (true, _) => "none, the key is required",
        (false, None) => "unset",
        (false, Some(default)) => default,
    };
    wrap(&format!("Allowed: {allowed}. Default: {default}."), "# ", "# ", &mut lines);
    lines
}

/// The checked ranges of a key, or what its type allows.
fn allowed(key: &SchemaKey<'_>, rules: &[Rule]) -> String {
    let mut parts: Vec<String> = Vec::new();
    for rule in rules {
        let part = match rule.field.strip_prefix(&key.path) {
            Some("") => rule.expected.clone(),
            Some(entry) if entry.starts_with('[') => format!("each {}", rule.expected),
            Some(" (entries)") => format!("{} long", rule.expected),
            _ => continue,
        };
        if !parts.contains(&part) {
            parts.push(part);
        }
    }
    if parts.is_empty() || key.values["items"].is_object() {
        parts.insert(0, key.kind());
    }
    parts.join(", ")
}

/// Appends `text` in lines of at most [`WIDTH`] characters, the first behind `first` and the others behind `next`.
fn wrap(text: &str, first: &str, next: &str, lines: &mut String) {
    let mut line = String::new();
    for word in text.split_whitespace() {
        let begun = if line.is_empty() { first } else { line.as_str() };
        if line.is_empty() || begun.chars().count() + 1 + word.chars().count() <= WIDTH {
            let gap = if line.is_empty() { "" } else { " " };
            line = format!("{begun}{gap}{word}");
        } else {
            *lines += line.trim_end();
            lines.push('\n');
            line = format!("{next}{word}");
        }
    }
    if !line.is_empty() {
        *lines += &line;
        lines.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{super::EMBEDDED_NAMES, *};

    fn with(overrides: &[&str]) -> Config {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        Config::embedded("geo", &overrides).unwrap()
    }

    fn read_back(text: &str) -> Config {
        Config::from_toml(text, Path::new("commented.toml"), &[]).unwrap()
    }

    #[test]
    fn commented_trees_read_back_as_the_same_configuration() {
        let mut configs = EMBEDDED_NAMES.map(|name| Config::embedded(name, &[]).unwrap()).to_vec();
        configs.push(with(&[
            "model.color={kind=\"none\", out_dim=8}",
            "data.train=a b",
            "train.precision=bf16",
        ]));
        configs.push(with(&[
            "name=\"two\\nseed = 3\"",
            "model.color={kind=\"vit\", weights=\"dino.pth\"}",
            "model.image_size=112",
        ]));
        for config in configs {
            assert_eq!(read_back(&config.to_commented_toml().unwrap()), config);
        }
        let synth = SynthConfig { images: 7, bins: 0.3, ..SynthConfig::default() };
        let text = synth.to_commented_toml().unwrap();
        assert_eq!(read_back(&text), Config { synth, ..Config::default() });
        assert!(!text.contains("[train]"), "{text}");
    }

    #[test]
    fn a_comment_precedes_every_key() {
        for name in EMBEDDED_NAMES {
            let text = Config::embedded(name, &[]).unwrap().to_commented_toml().unwrap();
            let lines: Vec<&str> = text.lines().collect();
            let keys = (0..lines.len()).filter(|&i| !lines[i].is_empty() && !lines[i].starts_with('#'));
            for i in keys {
                assert!(
                    i > 0 && lines[i - 1].starts_with("# "),
                    "no comment before {:?} of {name}",
                    lines[i]
                );
            }
            assert!(
                lines.iter().all(|line| line.chars().count() <= WIDTH || !line.starts_with('#')),
                "{text}"
            );
        }
    }

    #[test]
    fn comments_say_range_choices_and_default() {
        let text = with(&[]).to_commented_toml().unwrap();
        for expected in [
            "# Peak learning rate.\n# Allowed: above 0 and at most 10. Default: 0.0001.\nlearning_rate = 0.0008\n",
            "# Allowed: 2 numbers, each at least 0 and below 1. Default: [0.5, 0.999].\nbetas = [0.5, 0.999]\n",
            "#   \"off\": No overlap heads.\n# Allowed: one of these. Default: \"release\".\noverlap = \"release\"\n",
            "# Allowed: 3 whole numbers, each 1 to 8192. Default: none, the key is required.\nchannels = ",
            "# Allowed: text. Default: unset.\n# train = \"...\"\n",
            "# The coarse matching stage, on `coarse_points` per cloud.\n[model.coarse]\n",
        ] {
            assert!(text.contains(expected), "expected {expected} in:\n{text}");
        }
    }
}
