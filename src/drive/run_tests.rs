//! Whole drives of a corpus whose scenarios are windows of one recording.

use super::*;
use crate::export::Selection;
use crate::generate::{Futures, NamedDriver};
use crate::progress::Silent;
use crate::scenario::EgoChoice;
use crate::simulate::testing::{model, write_scenes, write_windows};
use crate::simulate::{RolloutConfig, World};
use crate::store::CorpusReader;
use std::path::PathBuf;

#[test]
fn recorded_arrivals_are_the_same_for_any_number_of_workers_and_from_saved_states() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = dir.path().join("corpus");
    write_windows(&corpus);
    let model = model();
    let futures = Futures::new(&model, 0, &candle_core::Device::Cpu).unwrap();
    let drive_with = |name: &str, n_workers: usize, horizon_s: f64, from: &Origin<'_>, scenes: Option<PathBuf>| {
        let config = DriveConfig {
            ego: EgoDriver::Named(NamedDriver::Careful),
            rollout: RolloutConfig { horizon_s, replan_s: 0.5 },
            time_limit_s: 1.0,
            save_at: Some(SaveAt::Timestep(24)),
            bisects: false,
            rates: false,
            split: None,
            n_workers,
            program: String::new(),
            scenes,
        };
        let out = dir.path().join(name);
        let report = drive_corpus((&corpus, &out), from, &EgoChoice::Scene, &config, &futures, &Silent).unwrap();
        let traffic = report.traffic["careful"];
        (traffic, fs_err::read(out.join(DRIVEN_FILE)).unwrap(), out.join(STATES_DIR).join("from1.json"))
    };
    let drive = |name: &str, n_workers: usize, horizon_s: f64, from: &Origin<'_>| {
        drive_with(name, n_workers, horizon_s, from, None)
    };
    let selection = Selection::default();
    let (traffic, bytes, state) = drive("one", 1, 3.0, &Origin::Scenarios(&selection));
    let n_recorded: u64 = traffic.n_arrived_recorded.iter().sum();
    assert!(n_recorded > 0 && n_recorded <= traffic.n_arrived.iter().sum(), "{traffic:?}");
    assert!(drive("two", 2, 3.0, &Origin::Scenarios(&selection)).1 == bytes);
    // On from before they came; the state is one of a longer drive, which expects more of them.
    let world = World::read(&state).unwrap();
    let (fork, bytes, again) = drive("fork", 1, 3.0, &Origin::State(world.clone()));
    assert!(fork.n_arrived_recorded.iter().sum::<u64>() > 0, "{fork:?}");
    assert!(drive("again", 2, 3.0, &Origin::State(world.clone())).1 == bytes);
    assert_eq!(fs_err::read(again).unwrap(), fs_err::read(&state).unwrap());
    assert!(drive("shorter", 1, 1.6, &Origin::State(world)).0.driven_s[0] > 0.0);
    // Scenes that have the first window alone: no arrivals are known after it.
    let scenes = dir.path().join("scenes");
    let reader = CorpusReader::open(&corpus).unwrap();
    write_scenes(&scenes, &reader, &[reader.scenario(0).unwrap().scenario.scene]);
    let alone = drive_with("alone", 1, 3.0, &Origin::Scenarios(&selection), Some(scenes)).0;
    assert_eq!(alone.n_arrived_recorded.iter().sum::<u64>(), 0, "{alone:?}");
}
