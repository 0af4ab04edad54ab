//! Writes the files of a drive.

use super::drives::Drives;
use super::margin::{Margin, Margins};
use super::page::Cards;
use super::rates::{Buckets, failure_rates};
use super::report::DriveReport;
use super::{DriveConfig, Error, FailureRates, Result, SplitFailures};
use crate::coverage::Tags;
use crate::files::AtomicFile;
use crate::generate::{Futures, NamedDriver};
use crate::report::render_drives;
use crate::scenario::DriveRow;
use crate::simulate::{Driven, Outcome, Situation};
use crate::store::{DrivenWriter, write_atomically, write_drives, write_json_atomically};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// The table of drives.
pub const DRIVES_FILE: &str = "drives.parquet";
/// The table of driven states.
pub const DRIVEN_FILE: &str = "driven.parquet";
/// The report; written last.
pub const DRIVE_FILE: &str = "drive.json";
/// The report for people.
pub const DRIVE_PAGE: &str = "drive.html";
/// What a planner writes to its standard error, by scenario; missing if it writes nothing.
pub const PLANNER_LOG: &str = "planner.log";
/// The folder of saved states.
pub const STATES_DIR: &str = "states";

/// All outputs, as far as they are known.
pub(super) struct Output<'a> {
    out: &'a Path,
    config: &'a DriveConfig,
    /// The command that drives a scenario again.
    again: String,
    states: DrivenWriter,
    rows: Vec<DriveRow>,
    tags: BTreeMap<String, Tags>,
    margins: Vec<Margin>,
    log: Option<AtomicFile>,
    cards: Cards,
    report: DriveReport,
}

impl<'a> Output<'a> {
    /// Nothing yet, in the folder `out`, for drives of this corpus.
    pub(super) fn create(
        (corpus, out): (&Path, &'a Path),
        config: &'a DriveConfig,
        futures: &Futures<'_>,
    ) -> Result<Self> {
        let quoted = |text: &str| format!("'{}'", text.replace('\'', r"'\''"));
        let again = format!(
            "djinn drive {} --scenario {{ID}} --ego {} --horizon-s {} --replan-s {} --seed {} --out again",
            quoted(&corpus.display().to_string()),
            quoted(config.ego.name()),
            config.rollout.horizon_s,
            config.rollout.replan_s,
            futures.seed()
        );
        Ok(Self {
            out,
            config,
            again,
            states: DrivenWriter::create(&out.join(DRIVEN_FILE))?,
            rows: Vec::new(),
            tags: BTreeMap::new(),
            margins: Vec::new(),
            log: None,
            cards: Cards::default(),
            report: DriveReport::new(&config.ego, Some(config.rollout), futures.seed(), futures.fingerprint()),
        })
    }

    pub(super) fn add(&mut self, situation: &Situation, drives: Drives) -> Result<()> {
        self.tags.insert(situation.scenario_id.clone(), Tags::of(&situation.scene));
        let careful = drives.of(NamedDriver::Careful);
        let judged = careful.map(|driven| driven.outcome).filter(|outcome| *outcome != Outcome::NotSampled);
        let careful_survives = judged.map(|outcome| outcome == Outcome::Survived);
        for (name, driven) in &drives.all {
            let scene = situation.driven(&driven.world);
            let (n_history, plan_ends) = (scene.n_history, driven.world.plan_ends);
            let moved_by = |agent_idx: usize, timestep: usize| match () {
                () if timestep < n_history => "scenario",
                () if agent_idx == situation.ego_idx => "driver",
                () if situation.planned.contains(&agent_idx) && timestep <= plan_ends => "plan",
                () => "model",
            };
            self.states.push([&situation.scenario_id, name], (&scene, &situation.event_roles), &moved_by)?;
            self.report.count(name, driven);
            self.rows.push(row(situation, name, driven, careful_survives));
            self.log(&situation.scenario_id, driven)?;
        }
        if let Some(saved) = drives.all.first().and_then(|(_, driven)| driven.saved.as_ref()) {
            let folder = self.out.join(STATES_DIR);
            fs_err::create_dir_all(&folder)?;
            // Ids are hexadecimal, but those of a foreign corpus need not be.
            let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            let name = situation.scenario_id.replace(|c: char| !is_plain(c), "_");
            let (path, text) = (folder.join(format!("{name}.json")), saved.to_json()?);
            write_atomically::<Error>(&path, |file| Ok(file.write_all(text.as_bytes())?))?;
            self.report.n_saved += 1;
        }
        if let Some(((own, asked), careful)) = drives.all.first().zip(careful) {
            let again = self.again.replace("{ID}", &situation.scenario_id);
            self.cards.offer(situation, &again, (own, asked), (NamedDriver::Careful.name(), careful));
        }
        self.margins.extend(drives.margin);
        Ok(())
    }

    /// Adds what the driver said in a scenario to the log.
    fn log(&mut self, scenario_id: &str, driven: &Driven) -> Result<()> {
        if driven.said.is_empty() {
            return Ok(());
        }
        let log = match &mut self.log {
            Some(log) => log,
            None => self.log.insert(AtomicFile::create(&self.out.join(PLANNER_LOG))?),
        };
        Ok(writeln!(log, "== {scenario_id}: {}\n{}", driven.outcome.name(), driven.said.trim_end())?)
    }

    /// The failures in 1,000 km of what was added, by the rates of these buckets.
    pub(super) fn failure_rates(&self, buckets: &Buckets) -> Vec<FailureRates> {
        failure_rates(&self.rows, self.config.ego.name_in_tables(), buckets)
    }

    /// Writes what is not written yet. Returns the report, in which scenarios that could not be driven are `left_out`.
    pub(super) fn finish(
        self,
        left_out: BTreeMap<String, u64>,
        (rates, split_rates): (Option<Vec<FailureRates>>, Option<Vec<SplitFailures>>),
    ) -> Result<DriveReport> {
        let Self { out, config, again: _, states, rows, tags, margins, log, cards, mut report } = self;
        states.finish()?;
        log.map(AtomicFile::commit).transpose()?;
        write_drives(&out.join(DRIVES_FILE), &rows)?;
        report.left_out = left_out;
        report.finish(&rows, config.ego.name_in_tables());
        (report.rates, report.split_rates) = (rates, split_rates);
        report.margins = config.bisects.then(|| Margins::of(margins));
        let page = render_drives(&cards.page(&report, &rows, config.ego.name_in_tables(), &tags));
        write_atomically::<Error>(&out.join(DRIVE_PAGE), |file| Ok(file.write_all(page.as_bytes())?))?;
        write_json_atomically(&out.join(DRIVE_FILE), &report)?;
        Ok(report)
    }
}

pub(super) fn row(situation: &Situation, driver: &str, driven: &Driven, careful_survives: Option<bool>) -> DriveRow {
    let n_steps = driven.world.n_timesteps() - situation.scene.n_history;
    DriveRow {
        scenario_id: situation.scenario_id.clone(),
        behavior: situation.behavior.clone(),
        driver: driver.to_owned(),
        outcome: driven.outcome.name().to_owned(),
        careful_survives,
        why: driven.why.clone(),
        lasted_s: n_steps as f64 * situation.scene.dt_s,
        contact: driven
            .contact
            .as_ref()
            .map(|contact| (contact.track.0.clone(), contact.side.name().to_owned(), contact.relative_mps)),
        min_ttc_s: driven.min_ttc_s,
        max_braking_mps2: driven.max_braking_mps2,
        progress_m: driven.progress_m,
        gave_up_plan: driven.gave_up_plan,
        event_happens: driven.event_happens,
        parameters: situation.parameters.clone(),
    }
}
