//! The crates depend on each other as `docs/architecture.md` says.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

#[test]
fn crates_depend_on_each_other_as_drawn() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = std::fs::read_to_string(root.join("docs/architecture.md")).unwrap();
    let drawn: BTreeMap<&str, BTreeSet<&str>> = page
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.strip_prefix("| `")?.strip_suffix('|')?.split(" | ").collect();
            let depends = cells.last()?.split(',').map(str::trim).filter(|name| !name.is_empty());
            Some((cells[0].trim_end_matches('`'), depends.collect()))
        })
        .collect();
    assert_eq!(drawn.len(), 18, "{drawn:?}");
    let mut above = BTreeSet::new();
    for line in page.lines().filter_map(|line| line.strip_prefix("| `")) {
        let name = line.split('`').next().unwrap();
        assert!(drawn[name].iter().all(|other| above.contains(other)), "{name} depends on crates below it");
        above.insert(name);
    }
    for (name, drawn) in &drawn {
        let folder = match *name {
            "unopose" => root.clone(),
            "unogen" => root.join("data-gen"),
            "configs" | "checkpoints" => root.join(name),
            _ => root.join("crates").join(name),
        };
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        let package = manifest["package"]["name"].as_str().unwrap();
        assert_eq!(package.strip_prefix("unopose-").unwrap_or(package), *name);
        let none = toml::Table::new();
        let dependencies = manifest.get("dependencies").and_then(|d| d.as_table()).unwrap_or(&none);
        let actual: BTreeSet<&str> =
            dependencies.keys().filter_map(|name| name.strip_prefix("unopose-")).collect();
        assert_eq!(actual, *drawn, "dependencies of {name}");
    }
}
