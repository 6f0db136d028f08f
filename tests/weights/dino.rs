//! Matching by DINOv2 weights, on small random transformers: the score against a second plain computation, the forms of the
//! files, and what is refused.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    frame::{DepthMap, Mask, MaskedView, RgbdFrame},
    geometry::Intrinsics,
};
use unopose_nn::{checkpoint::load_transformer, device::DeviceChoice};
use unopose_segment::{DinoMatcher, Matcher, Proposal, SegmentError};
use unopose_tests::backbone_files::{Sizes, Tensors, hugging_face, meta, safetensors, timm, weights};

const PATCH: usize = 28;
/// Patches per side of the 224 pixels that the transformer sees.
const GRID: usize = 8;
const WIDTH: usize = 64;

fn sizes(registers: usize, side: usize) -> Sizes {
    Sizes { width: WIDTH, depth: 2, patch: PATCH, side, registers }
}

/// An image of random colours.
fn frame(width: u32, height: u32, seed: u64) -> RgbdFrame {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rgb = RgbImage::from_fn(width, height, |_, _| image::Rgb(rng.random()));
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 20.0, cy: 20.0 };
    RgbdFrame { rgb, depth: DepthMap::zeros(width, height), intrinsics }
}

fn mask(frame: &RgbdFrame, inside: impl Fn(u32, u32) -> bool) -> Mask {
    let mut mask = Mask::empty(frame.width(), frame.height());
    for row in 0..mask.height {
        for col in 0..mask.width {
            mask.data[(row * mask.width + col) as usize] = inside(col, row);
        }
    }
    mask
}

/// A disc, an L, a thin diagonal, and everything.
fn masks(frame: &RgbdFrame) -> Vec<Mask> {
    let (w, h) = (frame.width(), frame.height());
    vec![
        mask(frame, |c, r| (c as i32 - 20).pow(2) + (r as i32 - 15).pow(2) < 120),
        mask(frame, |c, r| {
            (3..9).contains(&c) && (2..30).contains(&r) || (3..30).contains(&c) && (24..30).contains(&r)
        }),
        mask(frame, |c, r| c.abs_diff(r) < 1 && c < w.min(h)),
        mask(frame, |_, _| true),
    ]
}

/// Class token and patch tokens of a masked view, patches that are half outside at zero: as the definition says it, with
/// the whole image masked first, then cut, resized and padded.
fn tokens(path: &Path, frame: &RgbdFrame, mask: &Mask) -> (Vec<f64>, Vec<Vec<f64>>) {
    let (mean, std) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
    let b = mask.bounding_box().unwrap();
    let (w, h) = (b.col_max - b.col_min, b.row_max - b.row_min);
    let scale = 224.0 / f64::from(w.max(h));
    let resized = |side: u32| (f64::from(side) * scale + 1e-9).floor() as usize;
    let (left, top) = ((224 - resized(w)) / 2, (224 - resized(h)) / 2);
    let mut pixels = vec![0.0f32; 3 * 224 * 224];
    let mut covered = vec![0; GRID * GRID];
    for y in 0..resized(h) {
        for x in 0..resized(w) {
            let source = |i: usize, first: u32| first + (i as f64 / scale + 1e-9).floor() as u32;
            let (col, row) = (source(x, b.col_min), source(y, b.row_min));
            if !mask.get(col, row) {
                continue;
            }
            let (y, x) = (top + y, left + x);
            covered[y / PATCH * GRID + x / PATCH] += 1;
            for c in 0..3 {
                let value = f64::from(frame.rgb.get_pixel(col, row)[c]) / 255.0;
                pixels[(c * 224 + y) * 224 + x] = ((value - mean[c]) / std[c]) as f32;
            }
        }
    }
    let device = Device::flex();
    let image = Tensor::<4>::from_data(TensorData::new(pixels, [1, 3, 224, 224]), &device);
    let features = load_transformer(path, 224, &device).unwrap().forward(image);
    let double = |values: Vec<f32>| values.into_iter().map(f64::from).collect::<Vec<f64>>();
    let class = double(features.class_token.try_into_vec_as::<f32>().unwrap());
    let all = double(features.pyramid.try_into_vec_as::<f32>().unwrap());
    // The last of the four levels.
    let token = |p: usize| {
        let kept = if covered[p] > PATCH * PATCH / 2 { 1.0 } else { 0.0 };
        all[(p * 4 + 3) * WIDTH..][..WIDTH].iter().map(|value| kept * value).collect()
    };
    (class, (0..GRID * GRID).map(token).collect())
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    dot(a, b) / (dot(a, a).sqrt() * dot(b, b).sqrt()).max(1e-12)
}

type Tokens = (Vec<f64>, Vec<Vec<f64>>);

fn score(query: &Tokens, reference: &Tokens) -> f64 {
    let valid = query.1.iter().filter(|token| token.iter().any(|v| *v != 0.0));
    let best =
        |token: &Vec<f64>| reference.1.iter().map(|other| cosine(token, other)).fold(f64::MIN, f64::max);
    let local = valid.clone().map(best).sum::<f64>() / (valid.count() as f64 + 1e-6);
    0.5 * (cosine(&query.0, &reference.0).clamp(0.0, 1.0) + local.clamp(0.0, 1.0))
}

fn proposals(masks: Vec<Mask>) -> Vec<Proposal> {
    masks.into_iter().map(|mask| Proposal::new(mask, 0.5).unwrap()).collect()
}

fn close(a: &[f64], b: &[f64], tolerance: f64) {
    let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(a.len() == b.len() && apart < tolerance, "{a:?}\n{b:?}");
}

#[test]
fn scores_are_those_of_a_plain_computation() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dino.safetensors");
    for registers in [0, 4] {
        // The position embedding is resampled from 5 x 5.
        safetensors(&path, &meta(weights(sizes(registers, 5), 3)));
        let matcher = DinoMatcher::load(&path, DeviceChoice::Flex).unwrap();
        // Enlarged, and reduced: 300 pixels to 224.
        let (query, reference) = (frame(40, 34, 1), frame(300, 60, 2));
        let views = [
            mask(&reference, |c, r| (c as i32 - 150).pow(2) + (r as i32 - 30).pow(2) < 700),
            mask(&reference, |c, _| c < 40),
            mask(&reference, |_, r| r < 20),
            mask(&reference, |c, r| c > 200 && r > 10),
            mask(&reference, |c, r| (c + r) % 3 > 0 && c < 60),
            mask(&reference, |_, _| true),
            mask(&reference, |c, r| c > 100 && c < 140 && r < 50),
        ];
        let view = |mask| MaskedView { frame: &reference, mask };
        let one = matcher.object(&[view(&views[0])]).unwrap();
        let seven = matcher.object(&views.iter().map(view).collect::<Vec<_>>()).unwrap();
        let masks = masks(&query);
        let got = matcher.scores(&query, &proposals(masks.clone()), &[&one, &seven]).unwrap();
        let queries: Vec<Tokens> = masks.iter().map(|mask| tokens(&path, &query, mask)).collect();
        let references: Vec<Tokens> = views.iter().map(|mask| tokens(&path, &reference, mask)).collect();
        let expected: Vec<f64> = queries.iter().map(|q| score(q, &references[0])).collect();
        close(&got[0], &expected, 1e-5);
        // Five best of seven.
        let best = queries.iter().map(|q| {
            let mut scores: Vec<f64> = references.iter().map(|r| score(q, r)).collect();
            scores.sort_by(|a, b| b.total_cmp(a));
            scores[..5].iter().sum::<f64>() / 5.0
        });
        let best: Vec<f64> = best.collect();
        close(&got[1], &best, 1e-5);
        // The thin diagonal has no patch that is half inside: its class token alone counts.
        assert!(queries[2].1.iter().flatten().all(|v| *v == 0.0));
        assert!(expected[2] <= 0.5 && expected[3] != expected[0], "{expected:?}");
        // Another view of itself is the best there can be.
        let itself = matcher.object(&[MaskedView { frame: &query, mask: &masks[0] }]).unwrap();
        let scores = &matcher.scores(&query, &proposals(masks), &[&itself]).unwrap()[0];
        assert!((scores[0] - 1.0).abs() < 1e-5 && scores[1] < 0.999, "{scores:?}");
    }
}

#[test]
fn forms_of_the_file_and_batches_do_not_matter() {
    let folder = tempfile::tempdir().unwrap();
    let (query, reference) = (frame(40, 34, 1), frame(50, 40, 2));
    let all = masks(&query);
    let many: Vec<Mask> = (0..11).map(|i| all[i % all.len()].clone()).collect();
    for registers in [0, 4] {
        let made = weights(sizes(registers, GRID), 3);
        let mut first: Option<(Vec<f64>, String)> = None;
        let forms = [meta as fn(Tensors) -> Tensors, timm, hugging_face];
        for (form, name) in forms.into_iter().zip(["meta", "timm", "hf"]) {
            let path = folder.path().join(format!("{name}.safetensors"));
            safetensors(&path, &form(made.clone()));
            let matcher = DinoMatcher::load(&path, DeviceChoice::Flex).unwrap();
            let registers = if registers > 0 { "-reg4" } else { "" };
            assert_eq!(matcher.name(), format!("dinov2-vit-64x2-28{registers}"));
            let view = mask(&reference, |c, r| c > 5 && r > 8 && c + r < 60);
            let object = matcher.object(&[MaskedView { frame: &reference, mask: &view }]).unwrap();
            let scores =
                |masks: Vec<Mask>| matcher.scores(&query, &proposals(masks), &[&object]).unwrap().remove(0);
            let got = scores(many.clone());
            let alone: Vec<f64> = many.iter().flat_map(|mask| scores(vec![mask.clone()])).collect();
            close(&got, &alone, 1e-6);
            let (scores, _) = first.get_or_insert((got.clone(), matcher.fingerprint()));
            close(&got, scores, 1e-6);
        }
        // Kept results belong to the weights.
        let path = folder.path().join("other.safetensors");
        safetensors(&path, &meta(weights(sizes(registers, GRID), 4)));
        let other = DinoMatcher::load(&path, DeviceChoice::Flex).unwrap();
        assert_ne!(Some(other.fingerprint()), first.map(|(_, fingerprint)| fingerprint));
    }
}

#[test]
fn references_without_an_object_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dino.safetensors");
    safetensors(&path, &meta(weights(sizes(0, GRID), 3)));
    let matcher = DinoMatcher::load(&path, DeviceChoice::Flex).unwrap();
    let frame = frame(20, 16, 1);
    let refused = |mask: &Mask| {
        let error = matcher.object(&[MaskedView { frame: &frame, mask }]).err().unwrap();
        assert!(matches!(error, SegmentError::Reference { .. }));
        error.to_string()
    };
    assert!(refused(&Mask::empty(20, 16)).contains("all of it is background"));
    // Of another image.
    let mut beside = Mask::empty(40, 16);
    beside.data[30] = true;
    assert!(refused(&beside).contains("all of it is background"));
    assert!(matcher.object(&[]).err().unwrap().to_string().contains("there is none"));
    assert!(matcher.scores(&frame, &[], &[]).unwrap().is_empty());
}

#[test]
fn files_of_other_networks_are_refused_by_their_first_difference() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let refused = |tensors: &Tensors, parts: &[&str]| {
        safetensors(&path, tensors);
        let message = DinoMatcher::load(&path, DeviceChoice::Flex).err().unwrap().to_string();
        assert!(message.contains("weights.safetensors"), "{message}");
        parts.iter().for_each(|part| assert!(message.contains(part), "{part}: {message}"));
    };
    let values = |shape: &[usize]| (shape.to_vec(), vec![0.0; shape.iter().product()]);
    // SAM, whole and its encoder alone.
    let encoder = [
        ("pos_embed", values(&[1, 4, 4, 64])),
        ("patch_embed.proj.weight", values(&[64, 3, 16, 16])),
        ("blocks.0.attn.rel_pos_h", values(&[7, 16])),
        ("blocks.0.attn.qkv.weight", values(&[192, 64])),
    ];
    let sam = encoder.iter().map(|(name, tensor)| (format!("image_encoder.{name}"), tensor.clone()));
    let found = "found 4 tensors, the first is image_encoder.blocks.0.attn.qkv.weight";
    refused(&sam.collect(), &["holds no DINOv2 backbone", "patch_embed.proj.weight", found]);
    let mut encoder: Tensors = encoder.into_iter().map(|(name, tensor)| (name.to_owned(), tensor)).collect();
    refused(&encoder, &["cls_token is missing", "blocks.0.attn.rel_pos_h is unknown"]);
    encoder.insert("cls_token".into(), values(&[1, 1, 64]));
    refused(&encoder, &["pos_embed has shape [1, 4, 4, 64] in the checkpoint, [1, 196, 64] in the network"]);
    // Of another width, with a patch that does not divide the image, without a block in the middle.
    let odd = |sizes| meta(weights(sizes, 1));
    refused(&odd(Sizes { width: 24, ..sizes(0, 4) }), &["cls_token", "[1, 1, 24]", "a multiple of 64"]);
    refused(
        &odd(Sizes { patch: 15, ..sizes(0, 4) }),
        &["patch_embed.proj.weight", "[64, 3, 15, 15]", "divide 224"],
    );
    let mut holed = odd(Sizes { depth: 3, ..sizes(0, 4) });
    holed.retain(|name, _| !name.starts_with("blocks.1."));
    refused(&holed, &["blocks.1.attn.qkv.weight is missing"]);
    // A network of this program.
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../checkpoints/geo.safetensors");
    let message = DinoMatcher::load(&own, DeviceChoice::Flex).err().unwrap().to_string();
    assert!(
        message.contains("geo.safetensors") && message.contains("the first is coarse_point_matching."),
        "{message}"
    );
}
