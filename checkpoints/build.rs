//! Says whether there is a checkpoint to embed.

fn main() {
    println!("cargo::rerun-if-changed=geo.safetensors");
    println!("cargo::rustc-check-cfg=cfg(has_geo)");
    if std::path::Path::new("geo.safetensors").is_file() {
        println!("cargo::rustc-cfg=has_geo");
    }
}
