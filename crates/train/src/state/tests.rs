use super::*;
use burn::{
    nn::{BatchNorm, BatchNormConfig, Linear, LinearConfig},
    store::{ModuleSnapshot, bridge},
    tensor::{Device, Distribution, Tensor},
};
use unopose_core::config::TrainConfig;

#[derive(Module, Debug)]
struct Net {
    first: Linear,
    norm: BatchNorm,
    last: Linear,
}

fn net(device: &Device) -> Net {
    Net {
        first: LinearConfig::new(5, 16).init(device),
        norm: BatchNormConfig::new(16).init(device),
        last: LinearConfig::new(16, 1).init(device),
    }
}

fn config() -> Config {
    let train = TrainConfig { ema_decay: 0.9, clip_norm: 0.5, accumulation: 2, ..TrainConfig::default() };
    Config { train, ..Config::default() }
}

fn steps(optimization: &mut Optimization<Net>, range: std::ops::Range<u64>, device: &Device) {
    for step in range {
        for pass in 0..2 {
            device.seed(100 * step + pass);
            let x = Tensor::<2>::random([32, 5], Distribution::Default, device);
            let y = x.clone().square().sum_dim(1);
            let model = optimization.model();
            let hidden = burn::tensor::activation::relu(model.norm.forward(model.first.forward(x)));
            let loss = (model.last.forward(hidden) - y).square().mean();
            optimization.accumulate(loss);
        }
        optimization.apply(1e-2 / (1.0 + step as f64));
    }
}

fn bits<M: Module>(model: &M) -> Vec<(String, Vec<u32>)> {
    let tensors = model.valid().collect(None, None, true);
    let bits = tensors.into_iter().map(|t| {
        let name = t.name.clone();
        let values = bridge::into_data(t).unwrap().try_into_vec::<f32>().unwrap();
        (name, values.into_iter().map(f32::to_bits).collect())
    });
    bits.collect()
}

#[test]
fn half_the_steps_and_a_resume_equal_all_steps_bit_for_bit() {
    let device = Device::default().autodiff();
    let config = config();
    let folder = tempfile::tempdir().unwrap();
    device.seed(7);
    let start = net(&device);
    // Parameters initialise on first use; the two runs must start from the same values.
    bits(&start);

    let mut whole = Optimization::new(start.clone(), &config.train);
    // Batch statistics are shared between clones of a module: `fork` them apart by a trip through `valid`.
    let mut half = Optimization::new(start.valid().train(), &config.train);
    steps(&mut half, 0..4, &device);
    let state = RunState { next_pair: 16, elapsed_s: 0.1, validation_due: true, finished: false };
    save(folder.path(), &half, &config, &state).unwrap();
    drop(half);

    device.seed(8);
    let mut resumed = Optimization::new(net(&device), &config.train);
    let read = restore(folder.path(), &mut resumed, &config.model, false).unwrap();
    assert_eq!(read, Some(state));
    assert_eq!(resumed.step(), 4);
    steps(&mut resumed, 4..8, &device);
    steps(&mut whole, 0..8, &device);
    assert_eq!(bits(resumed.model()), bits(whole.model()));
    assert_eq!(bits(resumed.average().unwrap()), bits(whole.average().unwrap()));
    assert_ne!(bits(resumed.model()), bits(resumed.average().unwrap()));
}

#[test]
fn a_crash_between_the_two_writes_leaves_the_previous_state() {
    let device = Device::default().autodiff();
    let config = config();
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    let mut optimization = Optimization::new(net(&device), &config.train);
    assert_eq!(restore(run, &mut optimization, &config.model, false).unwrap(), None);
    steps(&mut optimization, 0..1, &device);
    save(run, &optimization, &config, &RunState::default()).unwrap();
    let saved = bits(optimization.model());
    // What a kill leaves: the next step's folder complete or half written, the weights still the old ones.
    fs::create_dir_all(run.join("state-2")).unwrap();
    fs::create_dir_all(run.join(".part-state-3")).unwrap();
    // What others put there.
    fs::create_dir_all(run.join("state-of-mind")).unwrap();
    steps(&mut optimization, 1..2, &device);
    restore(run, &mut optimization, &config.model, false).unwrap();
    assert_eq!((optimization.step(), bits(optimization.model())), (1, saved));
    steps(&mut optimization, 1..4, &device);
    save(run, &optimization, &config, &RunState::default()).unwrap();
    let mut names: Vec<_> =
        fs::read_dir(run).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    // The half-written one goes when the next call begins.
    assert_eq!(names, [".part-state-3", "last.safetensors", "state-4", "state-of-mind"]);
}

#[test]
fn a_state_of_another_past_is_not_taken_for_this_one() {
    let device = Device::default().autodiff();
    let config = config();
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    let names = || {
        let entries = fs::read_dir(run).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = entries.filter(|name| name.starts_with("state-")).collect();
        names.sort();
        names
    };
    let mut optimization = Optimization::new(net(&device), &config.train);
    steps(&mut optimization, 0..2, &device);
    save(run, &optimization, &config, &RunState::default()).unwrap();
    // The same step again is the same state.
    save(run, &optimization, &config, &RunState { finished: true, ..RunState::default() }).unwrap();
    assert_eq!(names(), ["state-2"]);
    // A killed run left the folder of step 4, this one arrives at step 4 by another way.
    let mut other = Optimization::new(net(&device), &config.train);
    steps(&mut other, 3..7, &device);
    let elsewhere = tempfile::tempdir().unwrap();
    save(elsewhere.path(), &other, &config, &RunState::default()).unwrap();
    fs::rename(elsewhere.path().join("state-4"), run.join("state-4")).unwrap();
    steps(&mut optimization, 2..4, &device);
    save(run, &optimization, &config, &RunState::default()).unwrap();
    assert_eq!(names(), ["state-4-2"]);
    let mut resumed = Optimization::new(net(&device), &config.train);
    restore(run, &mut resumed, &config.model, false).unwrap();
    assert_eq!(bits(resumed.average().unwrap()), bits(optimization.average().unwrap()));
    steps(&mut optimization, 4..5, &device);
    steps(&mut resumed, 4..5, &device);
    assert_eq!(bits(resumed.model()), bits(optimization.model()));
}

#[test]
fn damage_is_named_and_only_on_request_are_the_moments_left_out() {
    let device = Device::default().autodiff();
    let config = config();
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    let mut optimization = Optimization::new(net(&device), &config.train);
    steps(&mut optimization, 0..3, &device);
    save(run, &optimization, &config, &RunState { next_pair: 12, ..RunState::default() }).unwrap();
    let resume = |reset: bool| {
        let mut resumed = Optimization::new(net(&device), &config.train);
        restore(run, &mut resumed, &config.model, reset).map(|state| (resumed, state.unwrap()))
    };
    let file = |name: &str| run.join("state-3").join(name);
    for name in ["optimizer.bpk", "average.safetensors", "manifest.json"] {
        let whole = fs::read(file(name)).unwrap();
        let mut flipped = whole.clone();
        let middle = flipped.len() / 2;
        flipped[middle] ^= 4;
        for damaged in [flipped, whole[..middle].to_vec(), Vec::new()] {
            fs::write(file(name), damaged).unwrap();
            let error = resume(false).err().unwrap().to_string();
            // A manifest with another number is a complaint about the file of that number.
            let named = name == "manifest.json" || error.contains(name);
            assert!(named && error.contains("state-3") && error.contains("--reset-optimizer"), "{error}");
            let (mut resumed, state) = resume(true).unwrap();
            assert_eq!((resumed.step(), state.next_pair), (3, 12));
            assert_eq!(bits(resumed.model()), bits(optimization.model()));
            let average =
                if name == "optimizer.bpk" { optimization.average().unwrap() } else { resumed.model() };
            assert_eq!(bits(resumed.average().unwrap()), bits(average), "{name}");
            steps(&mut resumed, 3..4, &device);
        }
        fs::write(file(name), whole).unwrap();
    }
    fs::remove_file(file("optimizer.bpk")).unwrap();
    let error = resume(false).err().unwrap().to_string();
    assert!(error.contains("optimizer.bpk: No such file"), "{error}");
}
