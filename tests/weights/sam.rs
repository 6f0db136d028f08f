//! Segment Anything and MobileSAM against tensors of their original implementations (PyTorch 2.15 on a CPU) on small
//! networks with random weights: every block, the prompts, masks and overlaps, and the automatic masks.

use burn::tensor::Tensor;
use unopose_core::frame::BoundingBox;
use unopose_segment::{
    Prompt, ProposalGenerator, SamProposals,
    sam::{ImageEncoder, ResizeLongestSide, Sam, SamCheckpoint, Upscaling, stability},
};
use unopose_tests::pytorch_file::Pickled;
use unopose_tests::reference_tensors::max_difference;
use unopose_tests::sam_case::SamCase;
use unopose_tests::test_device::test_device;

/// MobileSAM's files do not say for which images they are; the small network is for these.
const IMAGE_SIZE: usize = 96;

struct Case(SamCase);

impl Case {
    fn open(name: &str) -> Self {
        Self(SamCase::open(name))
    }

    fn checkpoint(&self) -> SamCheckpoint {
        let mut checkpoint = SamCheckpoint::open(&self.0.weights()).unwrap();
        checkpoint.sizes.image_size = IMAGE_SIZE;
        checkpoint
    }

    fn network(&self) -> Sam {
        self.checkpoint().into_network(&test_device()).unwrap()
    }

    fn resize(&self) -> ResizeLongestSide {
        ResizeLongestSide::new(72, 50, IMAGE_SIZE as u32)
    }

    fn input(&self) -> Tensor<4> {
        self.resize().tensor(&self.0.frame().rgb, &test_device())
    }

    /// Largest difference relative to the largest value.
    #[track_caller]
    fn check<const D: usize>(&self, name: &str, got: Tensor<D>) {
        let (shape, expected) = self.0.file.f32(name);
        let dims: Vec<usize> = got.dims().into_iter().filter(|&n| n > 1).collect();
        assert_eq!(dims, shape.iter().copied().filter(|&n| n > 1).collect::<Vec<_>>(), "{name}");
        self.check_values(name, numbers(got), &expected);
    }

    #[track_caller]
    fn check_values(&self, name: &str, got: Vec<f32>, expected: &[f32]) {
        let largest = expected.iter().fold(1.0f32, |m, v| m.max(v.abs()));
        let difference = max_difference(got, expected) / largest;
        println!("{name}: {difference:.1e} of {largest:.1}");
        // Single precision through a few dozen layers; a wrong offset or order moves values by their own size.
        assert!(difference < 1e-5, "{name}: {difference}");
    }

    /// Points of the reference in the padded input.
    fn points(&self) -> Vec<[f64; 2]> {
        let points = self.0.file.f32("points").1;
        points.as_chunks::<2>().0.iter().map(|p| self.resize().point(p.map(f64::from))).collect()
    }
}

fn numbers<const D: usize>(x: Tensor<D>) -> Vec<f32> {
    x.into_data().try_into_vec().unwrap()
}

#[test]
fn the_image_is_resized_as_pillow_does() {
    let case = Case::open("sam_vit");
    let (shape, expected) = case.0.file.int("resized");
    assert_eq!((shape[1], shape[0]), (96, 67));
    let input = numbers(case.input());
    for (channel, (mean, deviation)) in
        [(123.675, 58.395), (116.28, 57.12), (103.53, 57.375)].iter().enumerate()
    {
        for row in 0..IMAGE_SIZE {
            for col in 0..IMAGE_SIZE {
                let value = input[(channel * IMAGE_SIZE + row) * IMAGE_SIZE + col];
                let stored = (row < 67).then(|| expected[(row * 96 + col) * 3 + channel]);
                let wanted = stored.map_or(0.0, |level| (level as f32 - mean) / deviation);
                // A grey level is 0.017.
                assert!((value - wanted).abs() < 1e-5, "{channel} {row} {col}: {value} {wanted}");
            }
        }
    }
}

#[test]
fn every_block_of_the_vision_transformer_agrees() {
    let case = Case::open("sam_vit");
    let network = case.network();
    let ImageEncoder::Vit(encoder) = &network.image_encoder else { panic!("another encoder") };
    // 12 x 12 patches in windows of 5, padded to 15; the second block attends to all.
    let mut x = encoder.patches(case.input());
    for (index, block) in encoder.blocks.iter().enumerate() {
        x = block.forward(x, 12);
        case.check(&format!("block.{index}"), x.clone().reshape([12, 12, 32]));
    }
    let embedding = network.encode(case.input());
    case.check("embedding", embedding.tokens.swap_dims(1, 2).reshape([32, 12, 12]));
}

#[test]
fn every_stage_of_tiny_vit_agrees() {
    let case = Case::open("sam_tiny_vit");
    let network = case.network();
    let ImageEncoder::TinyVit(encoder) = &network.image_encoder else { panic!("another encoder") };
    let tokens = |x: Tensor<4>| {
        let [_, channels, h, w] = x.dims();
        x.reshape([1, channels, h * w]).swap_dims(1, 2)
    };
    let mut x = encoder.patches(case.input());
    case.check("patches", tokens(x.clone()));
    // Windows of 5, 4 and 3 on grids of 12, 6 and 6: with padding and without.
    for (index, stage) in encoder.layers.iter().enumerate() {
        x = stage.forward(x);
        case.check(&format!("layer.{index}"), tokens(x.clone()));
    }
    let embedding = network.encode(case.input());
    case.check("embedding", embedding.tokens.swap_dims(1, 2).reshape([32, 6, 6]));
}

#[test]
fn prompts_masks_and_overlaps_agree() {
    for name in ["sam_vit", "sam_tiny_vit"] {
        let case = Case::open(name);
        let network = case.network();
        let image = network.encode(case.input());
        let [h, w] = image.grid;
        let positions = network.prompt_encoder.positions(image.grid);
        case.check("dense_pe", positions.swap_dims(1, 2).reshape([32, h, w]));
        let prompts = network.prompt_encoder.embed_points(&case.points());
        case.check("points.sparse", prompts.clone());
        let decoded = network.decode(&image, prompts);
        case.check("points.iou", decoded.iou.clone());
        case.check("points.low_res", network.masks(&image, &decoded, 0, 0..4));
        case.check("points.low_res_last", network.masks(&image, &decoded, 2, 3..4));
        let small = numbers(network.masks(&image, &decoded, 1, 1..4));
        let upscaling = Upscaling::new(4 * h, &case.resize());
        let large: Vec<f32> =
            small.chunks_exact(16 * h * w).flat_map(|logits| upscaling.apply(logits)).collect();
        case.check_values("points.logits", large.clone(), &case.0.file.f32("points.logits").1);
        let expected = &case.0.file.f32("points.stability").1[3..6];
        let got = large.chunks_exact(72 * 50).map(|logits| stability(logits).unwrap() as f32);
        assert!(max_difference(got, expected) < 1e-6);
    }
}

#[test]
fn a_point_and_a_box_give_the_masks_of_the_original() {
    for name in ["sam_vit", "sam_tiny_vit"] {
        let case = Case::open(name);
        let sam = SamProposals::new(case.checkpoint(), &test_device()).unwrap();
        let inside = |logits: &[f32]| logits.iter().map(|&l| l > 0.0).collect::<Vec<bool>>();
        let corners = case.0.file.f32("box").1;
        let [col_min, row_min, col_max, row_max] = [0, 1, 2, 3].map(|i| corners[i] as u32);
        let bounds = BoundingBox { col_min, row_min, col_max, row_max };
        let found = sam.segment_prompt(&case.0.frame(), Prompt::Box(bounds)).unwrap();
        assert_eq!(found.mask.data, inside(&case.0.file.f32("box.logits").1), "{name}");
        let iou = case.0.file.f32("box.iou").1[0];
        assert!((found.score - iou.clamp(0.0, 1.0)).abs() < 1e-5, "{name}: {} {iou}", found.score);
        // The first point; its best mask of the last three has the overlap of the reference.
        let found = sam.segment_prompt(&case.0.frame(), Prompt::Point(10, 7)).unwrap();
        let overlaps = &case.0.file.f32("points.iou").1[1..4];
        let best = overlaps.iter().fold(0.0f32, |a, &b| a.max(b));
        assert!((found.score - best).abs() < 1e-5, "{name}: {} {best}", found.score);
        let error = sam.segment_prompt(&case.0.frame(), Prompt::Point(72, 7)).unwrap_err().to_string();
        assert!(error.contains("72,7") && error.contains("72 x 50"), "{error}");
    }
}

#[test]
fn automatic_masks_are_those_of_the_original() {
    for name in ["sam_vit", "sam_tiny_vit"] {
        let case = Case::open(name);
        let sam = SamProposals::new(case.checkpoint(), &test_device()).unwrap().with_points_per_side(6);
        // Of 108 masks, 40 and 72 are rated good, 37 of each are stable, 4 of each are distinct.
        let found = sam.proposals(&case.0.frame(), None).unwrap();
        let expected = case.0.file.f32("auto.iou").1;
        assert_eq!(found.len(), expected.len(), "{name}");
        assert!(max_difference(found.iter().map(|p| p.score), &expected) < 1e-5, "{name}");
        let masks = case.0.file.int("auto.masks").1;
        for (proposal, mask) in found.iter().zip(masks.chunks_exact(72 * 50)) {
            let different = proposal.mask.data.iter().zip(mask).filter(|(a, b)| **a != (**b != 0)).count();
            // A pixel of the working image at the threshold may fall to either side.
            assert!(different <= 1, "{name}: {different} of {}", proposal.mask.count());
        }
        assert!(sam.name().starts_with("sam-") && sam.name().ends_with("-6"), "{}", sam.name());
    }
}

/// What a file with some tensors changed is refused with.
fn refusal(case: &Case, change: impl Fn(&str, &[usize]) -> Option<(String, Vec<usize>)>) -> String {
    let list: Vec<Pickled> = case
        .checkpoint()
        .tensors
        .iter()
        .filter_map(|(name, data)| {
            let (name, shape) = change(name, data.shape())?;
            let values = vec![0.5; shape.iter().product()];
            Some(Pickled::f32(&name, &shape, &values))
        })
        .collect();
    let path = case.0.folder.path().join("changed.pth");
    unopose_tests::pytorch_file::write(&path, None, &list, b"");
    let network = SamCheckpoint::open(&path).and_then(|checkpoint| checkpoint.into_network(&test_device()));
    network.err().map(|error| error.to_string()).unwrap_or_default()
}

#[test]
fn pickles_load_and_every_difference_is_named() {
    let case = Case::open("sam_vit");
    let same = |name: &str, shape: &[usize]| Some((name.to_owned(), shape.to_vec()));
    assert_eq!(refusal(&case, same), "");
    let changed = "image_encoder.blocks.1.attn.qkv.weight";
    let message = refusal(&case, |name, shape| match name {
        "image_encoder.neck.0.weight" => None,
        "mask_decoder.iou_token.weight" => same("mask_decoder.hf_token.weight", shape),
        name if name == changed => same(name, &[96, 31]),
        name => same(name, shape),
    });
    for part in [
        "image_encoder.neck.0.weight is missing in the checkpoint",
        "mask_decoder.iou_token.weight is missing in the checkpoint",
        "mask_decoder.hf_token.weight is unknown to the network",
        "image_encoder.blocks.1.attn.qkv.weight has shape [96, 31] in the checkpoint, [96, 32] in the network",
    ] {
        assert!(message.contains(part), "{part} in: {message}");
    }
    // A backbone of DINOv2.
    let message = refusal(&case, |name, shape| {
        let name = name.strip_prefix("image_encoder.")?;
        same(name, shape)
    });
    let first = "the first is blocks.0.attn.proj.bias [32]";
    assert!(message.contains("no Segment Anything network") && message.contains(first), "{message}");
}

#[test]
fn half_precision_is_converted_with_a_notice() {
    let case = Case::open("sam_tiny_vit");
    let exact = case.checkpoint();
    let list: Vec<Pickled> = exact
        .tensors
        .iter()
        .map(|(name, data)| {
            // The upper half of each number is its bf16, rounded to zero.
            let bytes = data.as_bytes().as_chunks::<4>().0.iter().flat_map(|b| [b[2], b[3]]).collect();
            let shape = data.shape().to_vec();
            Pickled { name: format!("model.{name}"), shape, storage: "BFloat16Storage", bytes }
        })
        .collect();
    let path = case.0.folder.path().join("half.pt");
    unopose_tests::pytorch_file::write(&path, None, &list, b"");
    let read = SamCheckpoint::open(&path).unwrap();
    assert_eq!(read.notices, [format!("{} tensors converted from BF16 to F32", exact.tensors.len())]);
    let name = "image_encoder.layers.1.blocks.0.attn.attention_biases";
    let [a, b] = [&exact, &read].map(|c| c.tensors[name].try_to_vec::<f32>().unwrap());
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= a.abs() / 128.0));
    assert_eq!(exact.unused.iter().filter(|name| name.contains("num_batches_tracked")).count(), 18);
}
