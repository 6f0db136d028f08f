//! Says whether there is a checkpoint to embed.

fn main() {
    // The folder, so that a checkpoint that appears is noticed.
    println!("cargo::rerun-if-changed=checkpoints");
    println!("cargo::rustc-check-cfg=cfg(embedded_checkpoint)");
    if std::path::Path::new("checkpoints/geo.safetensors").is_file() {
        println!("cargo::rustc-cfg=embedded_checkpoint");
    }
}
