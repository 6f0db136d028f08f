//! `unoinfer segment` with weights of Segment Anything.

use std::process::{Command, Output};

use unopose_dataset::formats::image_io::{read_mask, write_rgb};
use unopose_tests::sam_case::SamCase;

/// `unoinfer` with the small vision transformer on its image, written to OUT.
fn unoinfer(case: &SamCase, command: &str, more: &[&str]) -> Output {
    let image = case.folder.path().join("image.png");
    write_rgb(&image, &case.frame().rgb).unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_unoinfer"));
    program.arg(command).args(more).current_dir(case.folder.path()).output().unwrap()
}

#[test]
fn the_program_takes_the_weights_as_its_proposals() {
    let case = SamCase::open("sam_vit");
    let segment = |more: &[&str]| {
        let all = [&["--rgb", "image.png", "--out", "out", "--device", "flex", "--proposals"], more].concat();
        unoinfer(&case, "segment", &all)
    };
    let text = |output: &Output| {
        let [out, err] =
            [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        assert!(!err.contains("panicked"), "{err}");
        out + &err
    };
    let output = segment(&["sam.safetensors", "--sam-points", "6"]);
    assert!(output.status.success() && text(&output).contains("4 masks in"), "{}", text(&output));
    let output = segment(&["sam.safetensors", "--box", "12,9,29,24"]);
    assert!(output.status.success(), "{}", text(&output));
    let mask = read_mask(&case.folder.path().join("out/mask.png")).unwrap();
    let logits = case.file.f32("box.logits").1;
    assert_eq!(mask.data, logits.iter().map(|&l| l > 0.0).collect::<Vec<bool>>());
    for (arguments, part) in [
        (vec!["sam.safetensors", "--point", "72,3"], "inside the image of 72 x 50"),
        (vec!["embedded", "--sam-points", "6"], "--sam-points is for weights of Segment Anything"),
        (vec!["absent.pth"], "absent.pth"),
    ] {
        let output = segment(&arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(text(&output).contains(part), "{arguments:?}: {}", text(&output));
    }
    let output = unoinfer(&case, "inspect", &["sam.safetensors"]);
    let said = text(&output);
    assert!(said.contains("kind: Segment Anything") && said.contains("image: 96 x 96 pixels"), "{said}");
}
