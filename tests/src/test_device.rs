//! The device that the tests of the network run on.

use burn::tensor::Device;
use unopose_nn::device::DeviceChoice;

/// The one named by `UNOPOSE_TEST_DEVICE`, else flex.
pub fn test_device() -> Device {
    let name = std::env::var("UNOPOSE_TEST_DEVICE").unwrap_or_else(|_| "flex".into());
    let choice: DeviceChoice = name.parse().unwrap();
    choice.open().unwrap_or_else(|e| panic!("UNOPOSE_TEST_DEVICE={name}: {e}")).0
}
