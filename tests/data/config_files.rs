//! Configuration files: the checked-in ones, and what a mistaken one says.

use std::path::Path;

use unopose_core::config::{ColorConfig, Config, ConfigError, EMBEDDED_NAMES, Quirks};

fn message(text: &str, overrides: &[&str]) -> String {
    let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
    Config::from_toml(text, Path::new("some.toml"), &overrides).expect_err("must be refused").to_string()
}

#[test]
fn checked_in_files_load_and_survive_a_round_trip() {
    for name in EMBEDDED_NAMES {
        let config = Config::embedded(name, &[]).unwrap();
        assert_eq!(config.name, name);
        let text = config.to_toml().unwrap();
        assert_eq!(Config::from_toml(&text, Path::new("again.toml"), &[]).unwrap(), config);
    }
    assert_eq!(Config::embedded("unopose", &[]).unwrap().model.quirks, Quirks::release());
    assert_eq!(Config::embedded("geo", &[]).unwrap().model.quirks, Quirks::corrected());
    assert!(matches!(Config::embedded("large", &[]), Err(ConfigError::Embedded { .. })));
}

#[test]
fn an_unknown_key_names_file_line_and_nearest_key() {
    let text = message("name = \"x\"\n\n[train]\nstepz = 3\n", &[]);
    assert!(text.starts_with("some.toml:4: "), "{text}");
    assert!(text.contains("`stepz`") && text.contains("nearest valid: `steps`"), "{text}");
}

#[test]
fn an_unknown_key_inside_a_tagged_table_is_found_too() {
    let text = message("[model.color]\nkind = \"vit\"\n\nembed_dims = 3\n", &[]);
    assert!(text.starts_with("some.toml:4: "), "{text}");
    assert!(text.contains("nearest valid: `embed_dim`"), "{text}");
    let text = message("[model]\nimage_size = 32\noverlap = \"relaese\"\n", &[]);
    assert!(text.starts_with("some.toml:3: ") && text.contains("`release`"), "{text}");
}

#[test]
fn a_wrong_type_names_its_line() {
    let text = message("[train]\nsteps = 10\nbatch_size = \"eight\"\n", &[]);
    assert!(text.starts_with("some.toml:3: "), "{text}");
}

#[test]
fn overrides_replace_values_and_refuse_unknown_paths() {
    let set = ["train.learning_rate=1", "name=abc", "model.color={kind=\"none\", out_dim=8}", "seed=7"];
    let config = Config::from_toml("", Path::new("some.toml"), &set.map(String::from)).unwrap();
    assert_eq!((config.train.learning_rate, config.name.as_str(), config.seed), (1.0, "abc", 7));
    assert_eq!(config.model.color, ColorConfig::None { out_dim: 8 });

    let text = message("", &["trian.steps=3"]);
    assert!(text.starts_with("--set trian.steps=3: ") && text.contains("nearest valid: `train`"), "{text}");
    let text = message("", &["train.step=3"]);
    assert!(text.contains("nearest valid: `steps`"), "{text}");
    assert!(message("", &["train.steps"]).contains("expected path=value"));
}

#[test]
fn values_out_of_range_name_the_field() {
    let text = message("[model]\ncoarse_points = 300\nfine_points = 200\n", &[]);
    assert!(text.contains("model.fine_points is 200, expected at least 300"), "{text}");
    let text = message("", &["train.warmup_steps=188340"]);
    assert!(text.contains("train.warmup_steps is 188340"), "{text}");
    let text = message("", &["model.coarse.heads=3"]);
    assert!(text.contains("divisor of model.coarse.hidden_dim = 256"), "{text}");
    let text = message("", &["train.learning_rate=nan"]);
    assert!(text.contains("train.learning_rate is not a finite number"), "{text}");
}
