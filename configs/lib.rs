//! The configurations of this folder as text, so that a binary needs no file beside it.

/// Every configuration by name.
pub const ALL: [(&str, &str); 5] = [
    ("geo", include_str!("geo.toml")),
    ("unopose", include_str!("unopose.toml")),
    ("distil", include_str!("distil.toml")),
    ("proposals", include_str!("proposals.toml")),
    ("smoke", include_str!("smoke.toml")),
];
