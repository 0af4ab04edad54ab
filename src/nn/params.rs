//! Trainable parameters by name: the tensors of a model, and the source of their first values.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, Var, bail};

use super::{Compute, Precision};
use crate::seed::Seed;

/// How the first values of a parameter are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Init {
    /// All 0.
    Zeros,
    /// All 1.
    Ones,
    /// Uniform over ±1 / √`fan_in`, as in `torch.nn.Linear` for weights and biases.
    KaimingUniform {
        /// Number of inputs that each output sums over.
        fan_in: usize,
    },
}

impl Init {
    /// `n` values, drawn on the host so that they do not depend on the device.
    fn draw(self, n: usize, seed: Seed) -> Vec<f64> {
        match self {
            Self::Zeros => vec![0.0; n],
            Self::Ones => vec![1.0; n],
            Self::KaimingUniform { fan_in } => {
                let bound = 1.0 / (fan_in.max(1) as f64).sqrt();
                let mut rng = seed.rng();
                (0..n).map(|_| bound * (2.0 * rng.uniform() - 1.0)).collect()
            }
        }
    }
}

/// A model's parameters, ordered by name so that every sum over them and every file of them is reproducible.
#[derive(Debug, Clone)]
pub struct Params {
    vars: BTreeMap<String, Var>,
    compute: Compute,
    dtype: DType,
    use_of: Use,
}

/// What layers get of the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    /// The variables themselves, so that gradients reach them.
    Trained,
    /// Their bare values, which may still change.
    Frozen,
    /// Values of their own, with matrices stored as the processor multiplies by them.
    Settled,
}

impl Params {
    /// An empty set of `f32` parameters.
    pub fn new(compute: &Compute) -> Self {
        Self::with_dtype(compute, DType::F32)
    }

    /// An empty set of parameters of type `dtype`.
    pub fn with_dtype(compute: &Compute, dtype: DType) -> Self {
        Self { vars: BTreeMap::new(), compute: compute.clone(), dtype, use_of: Use::Trained }
    }

    /// A view of the parameters, sharing memory, for sampling and evaluation: layers built on them record nothing for a
    /// backward pass through the parameters, and see every later optimizer step.
    pub fn frozen(&self) -> Self {
        Self { use_of: Use::Frozen, ..self.clone() }
    }

    /// The parameters as they are now, for models that are not trained any more: layers built on them see no later
    /// change, and need not transpose their weights again and again.
    #[must_use]
    pub fn settled(self) -> Self {
        Self { use_of: Use::Settled, ..self }
    }

    /// The device that holds the parameters.
    pub fn device(&self) -> &Device {
        &self.compute.device
    }

    /// The parameter called `name`, drawn from the stream of that name when it does not exist yet: its first values
    /// depend on `seed`, `name` and `init` alone, not on which other parameters there are.
    pub fn get_or_init(&mut self, name: &str, shape: &[usize], init: Init, seed: Seed) -> Result<Tensor> {
        if let Some(var) = self.vars.get(name) {
            if var.dims() != shape {
                bail!("parameter {name} has shape {:?}, expected {shape:?}", var.dims());
            }
            return self.handle(var);
        }
        let values = init.draw(shape.iter().product(), seed.derive_named("init", name));
        let var = Var::from_tensor(&Tensor::from_vec(values, shape, &self.compute.device)?.to_dtype(self.dtype)?)?;
        let tensor = self.handle(&var);
        self.vars.insert(name.to_owned(), var);
        tensor
    }

    fn handle(&self, var: &Var) -> Result<Tensor> {
        match self.use_of {
            Use::Trained => Ok(var.as_tensor().clone()),
            Use::Settled if var.rank() == 2 => var.as_detached_tensor().t()?.contiguous()?.t(),
            Use::Frozen | Use::Settled => Ok(var.as_detached_tensor()),
        }
    }

    /// The parameters in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.vars.iter().map(|(name, var)| (name.as_str(), var))
    }

    /// Number of trainable values.
    pub fn n_parameters(&self) -> usize {
        self.vars.values().map(|var| var.elem_count()).sum()
    }

    /// The present values, outside every gradient. They share memory with the parameters: copy them to keep them beyond
    /// the next optimizer step.
    pub fn tensors(&self) -> BTreeMap<String, Tensor> {
        self.vars.iter().map(|(name, var)| (name.clone(), var.as_detached_tensor())).collect()
    }

    /// Overwrites every parameter in place, so that layers built on them see the new values.
    ///
    /// # Errors
    /// When names or shapes differ in any way; nothing is changed then, and the message lists the differences.
    pub fn load(&mut self, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
        let mut differences = Vec::new();
        for (name, var) in &self.vars {
            match tensors.get(name) {
                None => differences.push(format!("{name} is missing")),
                Some(found) if found.dims() != var.dims() => {
                    differences.push(format!("{name} has shape {:?}, not {:?}", found.dims(), var.dims()));
                }
                Some(_) => {}
            }
        }
        let unknown = tensors.keys().filter(|name| !self.vars.contains_key(*name));
        differences.extend(unknown.map(|name| format!("{name} is not a parameter of this model")));
        if !differences.is_empty() {
            bail!("the tensors do not fit the model: {}", differences.join("; "));
        }
        for (name, var) in &self.vars {
            // Detached copies, because a tensor that shares memory with the parameter would be read while it is
            // written.
            var.set(&tensors[name].detach().to_device(&self.compute.device)?.to_dtype(self.dtype)?.copy()?)?;
        }
        Ok(())
    }
}

/// A place in the tree of parameter names, from which a layer gets its tensors.
#[derive(Debug)]
pub struct Scope<'a> {
    params: &'a mut Params,
    prefix: String,
    seed: Seed,
}

impl<'a> Scope<'a> {
    /// The root of the tree; `seed` decides the first values of all parameters below it.
    pub fn root(params: &'a mut Params, seed: Seed) -> Self {
        Self { params, prefix: String::new(), seed }
    }

    /// The place `name` below this one.
    pub fn enter(&mut self, name: &str) -> Scope<'_> {
        Scope { prefix: self.path(name), params: self.params, seed: self.seed }
    }

    /// The parameter `name` at this place.
    pub fn tensor(&mut self, name: &str, shape: &[usize], init: Init) -> Result<Tensor> {
        let path = self.path(name);
        self.params.get_or_init(&path, shape, init, self.seed)
    }

    /// The precision of products with the tensors below this place.
    pub(super) fn precision(&self) -> Precision {
        self.params.compute.precision
    }

    fn path(&self, name: &str) -> String {
        if self.prefix.is_empty() { name.to_owned() } else { format!("{}.{name}", self.prefix) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::testing::values;

    #[test]
    fn first_values_depend_on_seed_and_name_alone() {
        let init = Init::KaimingUniform { fan_in: 16 };
        let mut alone = Params::new(&Compute::cpu());
        let a = Scope::root(&mut alone, Seed(3)).enter("trunk").tensor("weight", &[4, 16], init).unwrap();
        let mut among = Params::new(&Compute::cpu());
        let mut scope = Scope::root(&mut among, Seed(3));
        let other = scope.enter("head").tensor("weight", &[4, 16], init).unwrap();
        let b = scope.enter("trunk").tensor("weight", &[4, 16], init).unwrap();
        assert_eq!(values(&a), values(&b));
        assert_ne!(values(&a), values(&other));
        assert_eq!(among.iter().map(|(name, _)| name).collect::<Vec<_>>(), ["head.weight", "trunk.weight"]);
        assert_eq!(among.n_parameters(), 128);
        assert!(values(&a).iter().all(|v| v.abs() <= 0.25));
        // The variance of a uniform distribution over ±0.25 is 0.25² / 3.
        let variance = values(&a).iter().map(|v| v * v).sum::<f64>() / 64.0;
        assert!((variance - 0.25 * 0.25 / 3.0).abs() < 0.008, "{variance}");
    }

    #[test]
    fn loading_is_strict_and_reaches_the_layers() {
        let mut params = Params::new(&Compute::cpu());
        let weight = params.get_or_init("a", &[2], Init::Ones, Seed(0)).unwrap();
        params.get_or_init("b", &[3], Init::Zeros, Seed(0)).unwrap();
        assert!(params.get_or_init("a", &[3], Init::Ones, Seed(0)).is_err());

        let new = |n: usize| Tensor::new(vec![5f32; n], &Device::Cpu).unwrap();
        let wrong = BTreeMap::from([("a".to_owned(), new(3)), ("c".to_owned(), new(1))]);
        let message = params.load(&wrong).unwrap_err().to_string();
        for part in ["a has shape [3], not [2]", "b is missing", "c is not a parameter"] {
            assert!(message.contains(part), "{message}");
        }
        assert_eq!(values(&weight), [1.0, 1.0]);

        params.load(&BTreeMap::from([("a".to_owned(), new(2)), ("b".to_owned(), new(3))])).unwrap();
        assert_eq!(values(&weight), [5.0, 5.0]);
    }

    #[test]
    fn settled_matrices_are_stored_transposed() {
        let mut params = Params::new(&Compute::cpu());
        let init = Init::KaimingUniform { fan_in: 2 };
        let [drawn, settled] = [false, true].map(|is_settled| {
            params = if is_settled { params.clone().settled() } else { params.clone() };
            params.get_or_init("a", &[3, 2], init, Seed(0)).unwrap()
        });
        assert_eq!(drawn.to_vec2::<f32>().unwrap(), settled.to_vec2::<f32>().unwrap());
        assert!(drawn.is_contiguous() && settled.t().unwrap().is_contiguous());
    }
}
