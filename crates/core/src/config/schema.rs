//! What the types of the configuration tree say about its keys: doc comments, kinds of values, forms of a table.

use schemars::schema_for;
use serde_json::Value;

use super::Config;

/// The JSON schema of [`Config`].
pub(super) struct ConfigSchema(Value);

/// A key of the tree.
pub(super) struct SchemaKey<'s> {
    /// Dotted from the root.
    pub path: String,
    /// The key's doc comment; empty without one.
    pub text: &'s str,
    /// A table that has this key must give it.
    pub required: bool,
    /// The schema of its values, references resolved.
    pub values: &'s Value,
}

/// One of the words or table forms that a value may be.
pub(super) struct Choice<'s> {
    pub name: &'s str,
    pub text: &'s str,
}

impl ConfigSchema {
    pub fn new() -> Self {
        Self(schema_for!(Config).to_value())
    }

    /// Every key, a table before its own keys. Of a table with several forms those keys are listed whose form `is_chosen`
    /// by the path of the form's key and its name.
    pub fn keys(&self, is_chosen: &dyn Fn(&str, &str) -> bool) -> Vec<SchemaKey<'_>> {
        let mut keys = Vec::new();
        self.visit(&self.0, "", is_chosen, &mut keys);
        keys
    }

    fn visit<'s>(
        &'s self,
        table: &'s Value,
        parent: &str,
        is_chosen: &dyn Fn(&str, &str) -> bool,
        keys: &mut Vec<SchemaKey<'s>>,
    ) {
        let mut form_key = None;
        for form in choices(table) {
            let Some((name, value)) = form_name(form) else { continue };
            let path = join(parent, name);
            if is_chosen(&path, value) {
                self.visit(form, parent, is_chosen, keys);
            }
            form_key = Some(path);
        }
        if let Some(path) = form_key {
            keys.push(SchemaKey { path, text: text(table), required: false, values: table });
        }
        let Some(properties) = table["properties"].as_object() else { return };
        let required = table["required"].as_array().map_or(&[][..], Vec::as_slice);
        for (name, property) in properties.iter().filter(|(_, property)| property.get("const").is_none()) {
            let values = self.resolved(property);
            let path = join(parent, name);
            let required = required.iter().any(|key| key == name);
            keys.push(SchemaKey { path: path.clone(), text: text(property), required, values });
            self.visit(values, &path, is_chosen, keys);
        }
    }

    fn resolved<'s>(&'s self, property: &'s Value) -> &'s Value {
        let target = property["$ref"].as_str().and_then(|reference| reference.strip_prefix('#'));
        target.and_then(|pointer| self.0.pointer(pointer)).unwrap_or(property)
    }
}

impl<'s> SchemaKey<'s> {
    /// The words that the value is one of; none when it is no such value.
    pub fn choices(&self) -> Vec<Choice<'s>> {
        let values = self.values;
        let named = choices(values).iter().filter_map(|choice| {
            let name = choice["const"].as_str().or_else(|| Some(form_name(choice)?.1))?;
            Some(Choice { name, text: text(choice) })
        });
        // Words without a doc comment are one list.
        let groups = choices(values).iter().chain([values]).filter_map(|choice| choice["enum"].as_array());
        let unexplained = groups.flatten().filter_map(|name| Some(Choice { name: name.as_str()?, text: "" }));
        named.chain(unexplained).collect()
    }

    /// What its values are, for example "2 numbers".
    pub fn kind(&self) -> String {
        let list = self.values["items"].is_object();
        let (entry, many) =
            (if list { &self.values["items"] } else { self.values }, if list { "s" } else { "" });
        let name = match (entry["type"].as_str(), entry["minimum"].as_u64(), entry["maximum"].as_u64()) {
            (Some("boolean"), ..) => "true or false".to_owned(),
            (Some("integer"), Some(least), Some(most)) if !list => {
                format!("whole number from {least} to {most}")
            }
            (Some("integer"), Some(least), None) if !list => format!("whole number of at least {least}"),
            (Some("integer"), ..) => format!("whole number{many}"),
            (Some("number"), ..) => format!("number{many}"),
            _ => "text".to_owned(),
        };
        match (list, self.values["minItems"].as_u64()) {
            (false, _) => name,
            (true, Some(count)) => format!("{count} {name}"),
            (true, None) => format!("a list of {name}"),
        }
    }
}

/// `child` of the table at `parent`.
pub(super) fn join(parent: &str, child: &str) -> String {
    if parent.is_empty() { child.to_owned() } else { format!("{parent}.{child}") }
}

fn choices(values: &Value) -> &[Value] {
    values["oneOf"].as_array().map_or(&[], Vec::as_slice)
}

/// The key and the word that tell this form of a table.
fn form_name(form: &Value) -> Option<(&str, &str)> {
    form["properties"]
        .as_object()?
        .iter()
        .find_map(|(key, value)| Some((key.as_str(), value["const"].as_str()?)))
}

fn text(schema: &Value) -> &str {
    schema["description"].as_str().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_and_every_choice_has_a_doc_comment() {
        let schema = ConfigSchema::new();
        let keys = schema.keys(&|_, _| true);
        for path in
            ["model.color.kind", "model.color.weights", "model.color.channels", "synth.sensor.shiny_loss"]
        {
            assert!(keys.iter().any(|key| key.path == path), "{path} is not listed");
        }
        let without: Vec<&str> =
            keys.iter().filter(|key| key.text.is_empty()).map(|key| &*key.path).collect();
        assert!(without.is_empty(), "no doc comment: {without:?}");
        for key in &keys {
            for choice in key.choices() {
                assert!(!choice.text.is_empty(), "no doc comment: {} = {:?}", key.path, choice.name);
            }
        }
    }

    #[test]
    fn kinds_of_values_follow_the_types() {
        let schema = ConfigSchema::new();
        let keys = schema.keys(&|_, _| true);
        let kind = |path: &str| keys.iter().find(|key| key.path == path).unwrap().kind();
        assert_eq!(kind("train.workers"), "whole number of at least 0");
        assert_eq!(kind("train.betas"), "2 numbers");
        assert_eq!(kind("model.fine.pe_samples"), "2 whole numbers");
        assert_eq!(kind("synth.sensor.jpeg_quality"), "2 whole numbers");
        assert_eq!(kind("data.pose_noise.rotation_std_deg"), "a list of numbers");
        assert_eq!(kind("model.use_grf"), "true or false");
        assert_eq!(kind("data.train"), "text");
    }
}
