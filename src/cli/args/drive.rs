//! Arguments of `djinn drive` and `djinn score`.

use super::export::WhichArgs;
use super::{DeviceChoice, on_disk};
use crate::drive::SaveAt;
use crate::export::Selection;
use crate::nn::Precision;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct DriveArgs {
    /// The corpus: the folder that `evaluate` wrote
    #[arg(value_name = "CORPUS", value_parser = on_disk())]
    pub(in crate::cli) corpus: PathBuf,
    /// Who drives the ego: model, log, constant_velocity, idm, careful, or else the command of a planner
    #[arg(long, value_name = "CMD")]
    pub(in crate::cli) ego: String,
    /// The folder to write to; it must be new or empty
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) out: PathBuf,
    /// The model that moves all others: a checkpoint or its folder [default: distilled or denoiser beside the corpus]
    #[arg(long, value_name = "PATH", value_parser = on_disk())]
    pub(in crate::cli) model: Option<PathBuf>,
    /// Ingested scenes, such as the folder `scenes` of the run, which say who arrived in the recording of a scenario
    /// [default: the scenes of the corpus]
    #[arg(long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) scenes: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) chosen: ChosenArgs,
    /// How long to drive, seconds after the present
    #[arg(long, value_name = "S", default_value_t = 8.0)]
    pub(in crate::cli) horizon_s: f64,
    /// How long a plan is driven before all plan anew, seconds
    #[arg(long, value_name = "S", default_value_t = 0.5)]
    pub(in crate::cli) replan_s: f64,
    /// How long a planner may take for an answer, seconds; 30 s more for the first one of a process
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    pub(in crate::cli) time_limit_s: f64,
    /// Seed of the futures of the others
    #[arg(long, value_name = "SEED", default_value_t = 0, conflicts_with = "from")]
    pub(in crate::cli) seed: u64,
    /// Save the state of each drive at the first replanning at or after this timestep, or the beginning of the event
    #[arg(long, value_name = "event|TIMESTEP")]
    pub(in crate::cli) save_at: Option<SaveAt>,
    /// Make each scenario harder, too: how much later, and so closer to the ego, could the others of the event be for
    /// each driver to survive?
    #[arg(long, conflicts_with = "from")]
    pub(in crate::cli) bisect: bool,
    /// Say how often the planner would fail in 1,000 km at the places of the corpus, too: the rates of the events that
    /// it is tested with, times the shares that it fails
    #[arg(long, conflicts_with = "from")]
    pub(in crate::cli) rates: bool,
    /// Say the same without buckets, too, by this many loops that begin with held-out ones of --scenes and are split
    #[arg(long, value_name = "N", requires = "rates", requires = "scenes")]
    pub(in crate::cli) loops: Option<usize>,
    /// The required decelerations of the ego, m/s², at which its loops are split
    #[arg(long, value_name = "MPS2,…", value_delimiter = ',', default_values_t = [3.0, 6.0], requires = "loops")]
    pub(in crate::cli) levels: Vec<f64>,
    /// The loops that go on from a level instead of one
    #[arg(long, value_name = "N", default_value_t = 4, requires = "loops")]
    pub(in crate::cli) copies: usize,
    /// Drive on from this saved state instead
    #[arg(
        long,
        value_name = "STATE.json",
        value_parser = on_disk(),
        conflicts_with_all = ["behavior", "sweep", "scenarios", "limit"]
    )]
    pub(in crate::cli) from: Option<PathBuf>,
    /// The device to compute on: cpu, cuda or cuda:N, as in run.device; only the same kind gives the same bytes
    #[arg(long, default_value_t)]
    pub(in crate::cli) device: DeviceChoice,
    /// Precision of matrix products: f32, tf32 or bf16, as in run.precision
    #[arg(long, default_value_t)]
    pub(in crate::cli) precision: Precision,
    #[command(flatten)]
    pub(in crate::cli) gates: DriveGates,
}

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ScoreArgs {
    /// The corpus: the folder that `evaluate` wrote
    #[arg(value_name = "CORPUS", value_parser = on_disk())]
    pub(in crate::cli) corpus: PathBuf,
    /// The planned states: scenario_id, timestep (from the beginning of the past), x, y, heading in the frame of the
    /// recording; from the first timestep after the present to the end of the scenario
    #[arg(value_name = "PLANNED.parquet", value_parser = on_disk())]
    pub(in crate::cli) planned: PathBuf,
    /// The folder to write to; it must be new or empty
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) out: PathBuf,
    #[command(flatten)]
    pub(in crate::cli) chosen: ChosenArgs,
    #[command(flatten)]
    pub(in crate::cli) gates: DriveGates,
}

/// The scenarios that are driven, of those that were accepted, and the vehicle in them.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ChosenArgs {
    #[command(flatten)]
    pub(in crate::cli) which: WhichArgs,
    /// The vehicle that is driven: `event`, the one to which the requested event happens; `scene`, the center of the
    /// recorded window; or the name of a track
    #[arg(long, value_name = "event|scene|TRACK", default_value = "event")]
    pub(in crate::cli) ego_track: String,
}

/// Gates of a planner.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct DriveGates {
    /// Exit with code 3 if the planner fails in more scenarios than this
    #[arg(long, value_name = "N")]
    pub(in crate::cli) max_failures: Option<u64>,
    /// Exit with code 3 if it fails in more scenarios than this that the careful driver survives
    #[arg(long, value_name = "N")]
    pub(in crate::cli) max_avoidable: Option<u64>,
    /// Exit with code 3 if more of the chosen scenarios than this are not judged: without a plan, or a future of the
    /// others [default: 0 with one of the other two]
    #[arg(long, value_name = "N")]
    pub(in crate::cli) max_unjudged: Option<u64>,
}

impl ChosenArgs {
    /// The selection of accepted scenarios, and of ordinary ones that are named.
    pub(in crate::cli) fn selection(&self) -> Selection {
        let also_ordinary = self.which.sweep.is_some() || !self.which.scenarios.is_empty();
        Selection { only_accepted: true, also_ordinary, ..self.which.selection() }
    }
}
