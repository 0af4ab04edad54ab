//! Scenes for tests: small traffic written down in TOML, and scenes drawn at random.

mod case;
mod cases_test;
mod motion;
mod random;

pub(crate) use case::{Case, LaneSpec, SceneSpec, cases_in, lane_graph};
pub(crate) use random::{random_scene, transformed};
