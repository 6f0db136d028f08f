//! `--device`.

use clap::{
    Args,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use unopose_nn::device::DeviceChoice;

/// The argument that names the networks' compute device.
#[derive(Args, Clone, Copy, Debug)]
pub struct DeviceOption {
    /// Compute device of the networks
    #[arg(long, default_value = "auto", value_parser = parser())]
    device: DeviceChoice,
}

impl DeviceOption {
    /// The device that was asked for.
    pub fn choice(self) -> DeviceChoice {
        self.device
    }
}

fn parser() -> impl TypedValueParser<Value = DeviceChoice> {
    let values = [
        ("auto", "the first of cuda, wgpu, flex and ndarray that is built in and finds hardware"),
        ("flex", "CPU, multi-threaded and vectorised"),
        ("ndarray", "CPU, the older backend"),
        ("wgpu", "GPUs by Vulkan, Metal or WebGPU"),
        ("cuda", "NVIDIA GPUs"),
    ];
    let names = PossibleValuesParser::new(values.map(|(name, help)| PossibleValue::new(name).help(help)));
    names.try_map(|name| name.parse::<DeviceChoice>())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        device: DeviceOption,
    }

    #[test]
    fn every_device_is_an_argument_and_others_are_refused() {
        use DeviceChoice::*;
        for choice in [Auto, Flex, NdArray, Wgpu, Cuda] {
            let program = Program::try_parse_from(["program", "--device", &choice.to_string()]).unwrap();
            assert_eq!(program.device.choice(), choice);
        }
        assert_eq!(Program::try_parse_from(["program"]).unwrap().device.choice(), Auto);
        let message = Program::try_parse_from(["program", "--device", "abacus"]).err().unwrap().to_string();
        assert!(message.contains("[possible values: auto, flex, ndarray, wgpu, cuda]"), "{message}");
    }
}
