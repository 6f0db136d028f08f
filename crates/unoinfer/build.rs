//! Says whether the shared folder of benchmarks and reference tensors is there, so that tests that need it are reported as
//! ignored without it. `UNOPOSE_SHARED` names it; `../shared` beside the repository is the default.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=UNOPOSE_SHARED");
    println!("cargo::rustc-check-cfg=cfg(has_shared)");
    let folder = std::env::var("UNOPOSE_SHARED").unwrap_or_else(|_| "../../../shared".into());
    if std::fs::exists(folder).unwrap_or(false) {
        println!("cargo::rustc-cfg=has_shared");
    }
}
