//! Says which checkpoints there are to embed.

fn main() {
    for name in ["geo", "proposals"] {
        println!("cargo::rerun-if-changed={name}.safetensors");
        println!("cargo::rustc-check-cfg=cfg(has_{name})");
        if std::path::Path::new(&format!("{name}.safetensors")).is_file() {
            println!("cargo::rustc-cfg=has_{name}");
        }
    }
}
