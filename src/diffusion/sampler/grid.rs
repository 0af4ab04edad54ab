//! The noise levels of a sampler's steps, if they are not the denoiser's own.

use crate::diffusion::Edm;
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sampler's own grid of noise levels: few steps should not be spent where little is decided.
///
/// EDM (equation 5) begins at σ_max = 80, far above the data's σ_data = 0.5. From σ = 20 on, the data still is 1/1600
/// of the variance, so that pure noise is as good a start there.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StepGrid {
    /// The noise level of the first step. Left out: the denoiser's largest one, 80. Editing starts from its own `tau`.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e6))]
    pub sigma_max: Option<f64>,
    /// The noise level of the last step, which leads to 0. Left out: the denoiser's smallest one, 0.002.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_min: Option<f64>,
}

impl StepGrid {
    /// The constants of the diffusion with this grid.
    pub(super) fn laid_over(self, edm: &Edm) -> Edm {
        Edm {
            sigma_max: self.sigma_max.unwrap_or(edm.sigma_max),
            sigma_min: self.sigma_min.unwrap_or(edm.sigma_min),
            rho: edm.rho,
        }
    }

    /// Refuses a grid that does not go down.
    pub(super) fn validate(self) -> settings::Result {
        let Edm { sigma_max, sigma_min, .. } = self.laid_over(&Edm::default());
        match sigma_min < sigma_max {
            true => Ok(()),
            false => {
                Err(Issue::new("sigma_max", format_args!("is {sigma_max}, expected more than sigma_min, {sigma_min}")))
            }
        }
    }

    /// The suffix of a sampler's name; empty if the denoiser's own grid is kept.
    pub(super) fn suffix(self) -> String {
        let part = |word: &str, value: Option<f64>| value.map_or_else(String::new, |value| format!("-{word}-{value}"));
        [part("from", self.sigma_max), part("to", self.sigma_min)].concat()
    }
}

#[cfg(test)]
mod tests {
    use super::super::SamplerConfig;
    use super::*;

    fn sampler(grid: StepGrid) -> SamplerConfig {
        SamplerConfig::dpmpp_2m(3).on(grid)
    }

    #[test]
    fn levels_are_those_of_the_grid() {
        let even = sampler(StepGrid { sigma_max: Some(9.0), sigma_min: Some(1.0) });
        let edm = Edm { rho: 1.0, ..Edm::default() };
        assert_eq!(even.schedule(&edm, even.sigma_start(&edm)), [9.0, 5.0, 1.0, 0.0]);
        assert_eq!(even.name(), "dpmpp_2m-3-from-9-to-1");
        let own = sampler(StepGrid::default());
        assert_eq!(own.schedule(&Edm::default(), own.sigma_start(&Edm::default())), Edm::default().schedule(3));
        assert_eq!(own.name(), "dpmpp_2m-3");
    }

    #[test]
    fn an_edit_below_the_grid_still_goes_down() {
        let grid = sampler(StepGrid { sigma_min: Some(1.0), ..StepGrid::default() });
        assert_eq!(grid.schedule(&Edm::default(), 0.5), [0.5, 0.0]);
        let above = grid.schedule(&Edm::default(), 4.0);
        assert!(above.len() == 4 && above.windows(2).all(|pair| pair[0] > pair[1]), "{above:?}");
    }
}
