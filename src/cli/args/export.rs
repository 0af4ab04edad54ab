//! Arguments of `djinn export`.

use super::on_disk;
use crate::export::{ExportFormat, Selection};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct ExportArgs {
    /// The format to write
    #[arg(value_parser = FormatParser)]
    pub(in crate::cli) format: ExportFormat,
    /// The corpus: the folder that `evaluate` wrote
    #[arg(value_name = "CORPUS", value_parser = on_disk())]
    pub(in crate::cli) corpus: PathBuf,
    /// The folder to write to; it must be new or empty
    #[arg(short, long, value_name = "DIR", value_parser = on_disk())]
    pub(in crate::cli) out: PathBuf,
    /// Only verified scenarios: those that show the requested behavior
    #[arg(long)]
    pub(in crate::cli) only_verified: bool,
    /// Only accepted scenarios: verified, valid and not a near-duplicate
    #[arg(long)]
    pub(in crate::cli) only_accepted: bool,
    #[command(flatten)]
    pub(in crate::cli) which: WhichArgs,
    /// The ego: `event`, the vehicle to which the requested event happens, such as the one that is cut off; `scene`,
    /// the center of the recorded window; or the name of a track
    #[arg(long, value_name = "event|scene|TRACK", default_value = "event")]
    pub(in crate::cli) ego: String,
    /// Leave the ego to your driving function from the present on (openscenario; the default for commonroad)
    #[arg(long)]
    pub(in crate::cli) free_ego: bool,
    /// Write the ego like every other road user; in commonroad, as an obstacle beside the planning problem
    #[arg(long, conflicts_with = "free_ego")]
    pub(in crate::cli) replay_ego: bool,
}

/// Which scenarios of a corpus.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct WhichArgs {
    /// Only scenarios of this requested behavior, such as cut_in
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) behavior: Option<String>,
    /// Only scenarios of this sweep; `drive` and `score` take its valid ones if nothing is requested in it
    #[arg(long, value_name = "NAME")]
    pub(in crate::cli) sweep: Option<String>,
    /// Only the scenario with this id (may be repeated)
    #[arg(long = "scenario", value_name = "ID")]
    pub(in crate::cli) scenarios: Vec<String>,
    /// Only the first N of the scenarios
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    pub(in crate::cli) limit: Option<usize>,
}

impl WhichArgs {
    pub(in crate::cli) fn selection(&self) -> Selection {
        let Self { behavior, sweep, scenarios, limit } = self;
        let (behavior, sweep, scenario_ids) = (behavior.clone(), sweep.clone(), scenarios.clone());
        Selection { behavior, sweep, scenario_ids, limit: *limit, ..Selection::default() }
    }
}

/// Reads the name of a format; help and errors list them all.
#[derive(Debug, Clone, Copy)]
pub(in crate::cli) struct FormatParser;

impl clap::builder::TypedValueParser for FormatParser {
    type Value = ExportFormat;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<Self::Value, clap::Error> {
        let names = clap::builder::PossibleValuesParser::new(ExportFormat::ALL.map(ExportFormat::name));
        let name = names.parse_ref(command, arg, value)?;
        let format = ExportFormat::ALL.into_iter().find(|format| format.name() == name);
        format.ok_or_else(|| clap::Error::new(clap::error::ErrorKind::InvalidValue).with_cmd(command))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = clap::builder::PossibleValue> + '_>> {
        let value = |format: ExportFormat| clap::builder::PossibleValue::new(format.name()).help(format.description());
        Some(Box::new(ExportFormat::ALL.into_iter().map(value)))
    }
}
