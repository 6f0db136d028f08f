//! Names and shapes of a network's state without its values, which may not exist yet: parameters come into being when
//! they are first used.

use std::collections::BTreeMap;

use burn::{
    module::{Module, ModuleVisitor, Param},
    tensor::Tensor,
};

/// Shapes of all parameters and buffers under their official names and in PyTorch's layouts.
pub fn state_shapes<M: Module>(model: &M) -> BTreeMap<String, Vec<usize>> {
    let mut shapes = Shapes::default();
    model.visit(&mut shapes);
    shapes.found
}

#[derive(Default)]
struct Shapes {
    /// Name and kind of each module on the way to the current one.
    path: Vec<(String, String)>,
    found: BTreeMap<String, Vec<usize>>,
}

impl ModuleVisitor for Shapes {
    fn enter_module(&mut self, name: &str, kind: &str) {
        self.path.push((name.to_owned(), kind.to_owned()));
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let kind = self.path.iter().rev().find_map(|(_, kind)| kind.strip_prefix("Struct:"));
        // The variants of an enum have no name of their own.
        let names = self.path.iter().filter(|(_, kind)| !kind.starts_with("Enum:"));
        let mut names: Vec<&str> = names.map(|(name, _)| name.as_str()).collect();
        let mut shape = param.lazy_shape().to_vec();
        if kind == Some("Linear") && D == 2 {
            shape.reverse();
        }
        if let (Some("LayerNorm" | "BatchNorm" | "GroupNorm" | "RmsNorm"), Some(last)) =
            (kind, names.last_mut())
        {
            *last = match *last {
                "gamma" => "weight",
                "beta" => "bias",
                other => other,
            };
        }
        self.found.insert(names.join("."), shape);
    }
}

#[cfg(test)]
mod tests {
    use burn::{
        module::ModuleDisplay,
        store::{BurnToPyTorchAdapter, ModuleSnapshot},
        tensor::Device,
    };
    use unopose_core::config::Config;

    use super::*;
    use crate::model::UnoPose;

    #[test]
    fn they_are_those_of_the_stored_state() {
        fn stored<M: Module + ModuleDisplay>(model: &M) -> BTreeMap<String, Vec<usize>> {
            let tensors = model.collect(None, Some(Box::new(BurnToPyTorchAdapter)), true);
            tensors.into_iter().map(|tensor| (tensor.name.clone(), tensor.shape.to_vec())).collect()
        }
        let config = Config::embedded("smoke", &[]).unwrap();
        let model = UnoPose::new(&config.model, 0, &Device::default());
        let shapes = state_shapes(&model);
        assert_eq!(shapes, stored(&model));
        assert!(shapes.contains_key("coarse_point_matching.in_proj.weight"));
    }
}
