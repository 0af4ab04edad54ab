//! Drives every selected scenario of a corpus, with the careful driver beside, and writes the results.

use super::external::External;
use super::kept::Kept;
use super::margin::{Margin, Margins};
use super::page::Cards;
use super::report::DriveReport;
use super::told_apart::Tracks;
use super::{EgoDriver, Error, Result};
use crate::export::Selection;
use crate::files::{AtomicFile, NewFolder};
use crate::generate::{Futures, NamedDriver};
use crate::progress::Progress;
use crate::report::render_drives;
use crate::scenario::{DriveRow, EgoChoice};
use crate::simulate::{
    self, CHUNK, Careful, Driven, Driver, MOST_HORIZON_S, Maps, Others, Outcome, Places, RolloutConfig, Situation,
    World, in_parallel, named, pool_of_worker, roll_out,
};
use crate::store::{CorpusReader, DrivenWriter, SceneStore, write_atomically, write_drives, write_json_atomically};
use rayon::ThreadPool;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

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

/// How a corpus is driven.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveConfig {
    /// The driver of the ego.
    pub ego: EgoDriver,
    /// The settings of each drive.
    pub rollout: RolloutConfig,
    /// The time limit for an answer of a planner, seconds.
    pub time_limit_s: f64,
    /// When to save the state of each drive.
    pub save_at: Option<SaveAt>,
    /// Whether to find how much later the others of each event could be.
    pub bisects: bool,
    /// Scenarios driven at the same time, each with a planner of its own.
    pub n_workers: usize,
    /// The version of the program: drives of another one are not reused.
    pub program: String,
    /// The folder of ingested scenes that tell the arrivals in recordings; without it, the corpus does.
    pub scenes: Option<PathBuf>,
}

/// When to save the state of a drive: at the first replanning at or after this.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SaveAt {
    /// The beginning of the event.
    Event,
    /// A timestep, from the beginning of the past.
    Timestep(usize),
}

impl FromStr for SaveAt {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "event" => Ok(Self::Event),
            number => number.parse().map(Self::Timestep).map_err(|_| "expected event or a timestep".to_owned()),
        }
    }
}

/// Where to drive from.
#[derive(Debug)]
pub enum Origin<'a> {
    /// The present of the scenarios of this selection.
    Scenarios(&'a Selection),
    /// A saved state.
    State(World),
}

/// Drives scenarios of the corpus in `corpus`, in its order, and writes tables and report into the folder `out`, which
/// must be new or empty and appears when it is complete.
///
/// # Errors
/// Errors of the corpus, the folder and the model. A failure of a planner is an outcome.
pub fn drive_corpus(
    (corpus, out): (&Path, &Path),
    from: &Origin<'_>,
    ego: &EgoChoice,
    config: &DriveConfig,
    futures: &Futures<'_>,
    progress: &dyn Progress,
) -> Result<DriveReport> {
    config.rollout.check(futures)?;
    if config.ego.name().trim().is_empty() {
        let names = NamedDriver::ALL.map(NamedDriver::name).join(", ");
        return Err(Error::Config(format!("--ego is empty, expected {names} or the command of a planner")));
    }
    if !(config.time_limit_s > 0.0 && config.time_limit_s <= 3600.0) {
        let limit_s = config.time_limit_s;
        return Err(Error::Config(format!("time_limit_s is {limit_s:?}, expected more than 0 and at most 3600 s")));
    }
    let reader = CorpusReader::open(corpus)?;
    let (positions, limit) = match from {
        Origin::Scenarios(selection) => (selection.positions(&reader)?, selection.limit.unwrap_or(usize::MAX)),
        Origin::State(world) => (vec![reader.position(&world.scenario_id)?], 1),
    };
    let inputs = [("corpus", corpus)].into_iter().chain(config.scenes.as_deref().map(|scenes| ("scenes", scenes)));
    let folder = NewFolder::begin(out, inputs)?;
    let scenes = config.scenes.as_deref().map(SceneStore::open).transpose()?;
    let mut maps = Maps::new(&reader, scenes.as_ref().map_or(&reader, |scenes| scenes as &dyn Places));
    let of_scenes = scenes.as_ref().map_or("", SceneStore::fingerprint);
    let (kept, changed) = Kept::begin(out, &parts((&reader, of_scenes), from, ego, config, futures)?)?;
    if !changed.is_empty() {
        let changed = changed.join(", ");
        progress.warn(&format!("the drive begins anew: {changed} changed since it was interrupted"));
    }
    let mut report = DriveReport::new(&config.ego, Some(config.rollout), futures.seed(), futures.fingerprint());
    let states = DrivenWriter::create(&folder.path().join(DRIVEN_FILE))?;
    let mut output = Output { states, rows: Vec::new(), margins: Vec::new(), log: None };
    let runs = Arc::default();
    let mut workers: Vec<Worker> =
        (0..config.n_workers.max(1)).map(|_| Worker::new(config, &runs)).collect::<Result<_>>()?;
    let (mut tracks, mut cards) = (Tracks::default(), Cards::default());
    let mut positions = positions.into_iter();
    let mut n_chosen = 0;
    progress.start("drive", positions.len().min(limit) as u64, "scenarios");
    loop {
        let mut chunk = Vec::new();
        for position in positions.by_ref() {
            let record = reader.scenario(position)?;
            if !matches!(from, Origin::Scenarios(selection) if !selection.wants(&record)) {
                n_chosen += 1;
                match maps.situation(&record, ego) {
                    Ok(mut situation) => {
                        let dt_s = situation.scene.dt_s;
                        let [n_steps, _] = config.rollout.n_steps(dt_s);
                        // A saved state may be from a longer drive.
                        let (n_tracks, n_known) = match from {
                            Origin::Scenarios(_) => (0, n_steps),
                            Origin::State(world) => (world.n_tracks(), (MOST_HORIZON_S / dt_s) as usize),
                        };
                        maps.expect_arrivals(&mut situation, futures.seed(), [n_steps, n_tracks, n_known])?;
                        chunk.push(situation);
                    }
                    Err(simulate::Error::Unfit { why, .. }) => *report.left_out.entry(why).or_default() += 1,
                    Err(error) => return Err(error.into()),
                }
            }
            if chunk.len() >= CHUNK * workers.len() || n_chosen == limit {
                break;
            }
        }
        if chunk.is_empty() {
            break;
        }
        let drives = drive_chunk(&chunk, &mut workers, &kept, from, config, futures, progress)?;
        for (situation, (drives, margin)) in chunk.iter().zip(drives) {
            output.add(situation, &drives, config, folder.path(), &mut report)?;
            let scene = &situation.scene;
            if let Some(driven) = drives.first().filter(|_| tracks.want(&scene.id))
                && let Some(recorded) = reader.recorded_tracks(&scene.id, scene.n_timesteps)?
            {
                tracks.add(situation, &driven.world, &recorded, config.ego == EgoDriver::Named(NamedDriver::Model));
            }
            if let [asked, careful] = drives.as_slice() {
                cards.offer(situation, (own_name(&config.ego), asked), (NamedDriver::Careful.name(), careful));
            }
            output.margins.extend(margin);
        }
        if n_chosen == limit {
            break;
        }
    }
    progress.finish();
    if n_chosen == 0 {
        let wanted = match from {
            Origin::Scenarios(selection) => selection.words(),
            Origin::State(_) => "there".to_owned(),
        };
        return Err(Error::NothingSelected { corpus: corpus.to_owned(), n_scenarios: reader.len(), wanted });
    }
    if output.rows.is_empty() {
        let reasons: Vec<String> = report.left_out.iter().map(|(why, n)| format!("{n} times, it {why}")).collect();
        return Err(Error::NothingDriven { n_chosen, why: reasons.join("; ") });
    }
    let Output { states, rows, margins, log } = output;
    states.finish()?;
    log.map(AtomicFile::commit).transpose()?;
    write_drives(&folder.path().join(DRIVES_FILE), &rows)?;
    report.finish(&rows, own_name(&config.ego));
    report.told_apart = tracks.tell_apart();
    report.margins = config.bisects.then(|| Margins::of(margins));
    let page = render_drives(&cards.page(&report, &rows, own_name(&config.ego)));
    write_atomically::<Error>(&folder.path().join(DRIVE_PAGE), |file| Ok(file.write_all(page.as_bytes())?))?;
    write_json_atomically(&folder.path().join(DRIVE_FILE), &report)?;
    folder.commit()?;
    if kept.n_found() > 0 {
        progress.warn(&format!(
            "{} scenarios were not driven again: an interrupted drive with the same settings had done so",
            kept.n_found()
        ));
    }
    kept.remove()?;
    Ok(report)
}

/// Everything that drives depend on, except what a planner does beside the files that its command names.
fn parts(
    (reader, of_scenes): (&CorpusReader, &str),
    from: &Origin<'_>,
    ego: &EgoChoice,
    config: &DriveConfig,
    futures: &Futures<'_>,
) -> Result<[(&'static str, String); 5]> {
    let from = if let Origin::State(world) = from { Some(world) } else { None };
    // The number of simultaneous drives changes nothing.
    let own = DriveConfig { n_workers: 0, program: String::new(), ..config.clone() };
    Ok([
        ("the files of the planner", config.ego.files_hash()?),
        ("the settings", format!("{own:?} {ego:?} {from:?} {}", futures.seed())),
        ("the model", futures.fingerprint().to_owned()),
        ("the corpus", format!("{:?} {of_scenes}", reader.manifest())),
        ("the program", config.program.clone()),
    ])
}

/// The name of the driver under test in tables.
fn own_name(ego: &EgoDriver) -> &str {
    match ego {
        EgoDriver::External(_) => "planner",
        named => named.name(),
    }
}

/// The drives from a situation, by driver, and its margin.
pub(super) type Drives = (Vec<Driven>, Option<Margin>);

/// The drivers of one thread: the one under test, and the careful one if it is another.
struct Worker {
    asked: Box<dyn Driver>,
    careful: Option<Careful>,
    pool: ThreadPool,
}

impl Worker {
    /// The drivers of a thread; `runs` is shared by all processes of a planner.
    fn new(config: &DriveConfig, runs: &Arc<AtomicBool>) -> Result<Self> {
        let asked: Box<dyn Driver> = match &config.ego {
            EgoDriver::Named(driver) => named(*driver),
            EgoDriver::External(command) => Box::new(External::new(command, config.rollout, config.time_limit_s, runs)),
        };
        let careful = (config.ego != EgoDriver::Named(NamedDriver::Careful)).then(Careful::default);
        Ok(Self { asked, careful, pool: pool_of_worker()? })
    }

    /// The drives from one situation, of the driver under test and of the careful one, and their margin.
    fn drive(
        &mut self,
        situation: &Situation,
        from: &Origin<'_>,
        config: &DriveConfig,
        futures: &Futures<'_>,
    ) -> Result<Drives> {
        let others = Others::Sampled(futures);
        let start = || match from {
            Origin::Scenarios(_) => situation.start(futures.seed()),
            Origin::State(world) => world.clone(),
        };
        let save_at = config.save_at.map(|at| match at {
            SaveAt::Event => situation.event[0],
            SaveAt::Timestep(timestep) => timestep,
        });
        let Self { asked, careful, pool } = self;
        pool.install(|| {
            let driven = roll_out(situation, start(), asked.as_mut(), &others, &config.rollout, save_at)?;
            let beside = match careful {
                Some(careful) => Some(roll_out(situation, start(), careful, &others, &config.rollout, None)?),
                None => None,
            };
            let outcomes = [driven.outcome, beside.as_ref().map_or(driven.outcome, |beside| beside.outcome)];
            let margin = match (config.bisects, from) {
                (true, Origin::Scenarios(_)) => Margin::find(situation, outcomes, |driver, later| {
                    let driver: &mut dyn Driver = match careful {
                        Some(careful) if driver == 1 => careful,
                        _ => asked.as_mut(),
                    };
                    let start = later.start(futures.seed());
                    Ok(roll_out(later, start, driver, &others, &config.rollout, None)?.outcome)
                })?,
                _ => None,
            };
            Ok(([driven].into_iter().chain(beside).collect(), margin))
        })
    }
}

/// The drives of some situations in their order, whichever worker drives them.
fn drive_chunk(
    chunk: &[Situation],
    workers: &mut [Worker],
    kept: &Kept,
    from: &Origin<'_>,
    config: &DriveConfig,
    futures: &Futures<'_>,
    progress: &dyn Progress,
) -> Result<Vec<Drives>> {
    in_parallel(chunk, workers, |worker, situation| {
        let driven = match kept.get(&situation.scenario_id)? {
            Some(known) => known,
            None => {
                let driven = worker.drive(situation, from, config, futures)?;
                kept.put(&situation.scenario_id, &driven)?;
                driven
            }
        };
        progress.advance(1);
        Ok(driven)
    })
}

/// All outputs except the report.
struct Output {
    states: DrivenWriter,
    rows: Vec<DriveRow>,
    margins: Vec<Margin>,
    log: Option<AtomicFile>,
}

impl Output {
    fn add(
        &mut self,
        situation: &Situation,
        drives: &[Driven],
        config: &DriveConfig,
        out: &Path,
        report: &mut DriveReport,
    ) -> Result<()> {
        let careful = drives.last().map(|driven| driven.outcome).filter(|outcome| *outcome != Outcome::NotSampled);
        let careful_survives = careful.map(|outcome| outcome == Outcome::Survived);
        for (driven, name) in drives.iter().zip([own_name(&config.ego), NamedDriver::Careful.name()]) {
            let scene = situation.driven(&driven.world);
            let (n_history, plan_ends) = (scene.n_history, driven.world.plan_ends);
            let moved_by = |agent_idx: usize, timestep: usize| match () {
                () if timestep < n_history => "scenario",
                () if agent_idx == situation.ego_idx => "driver",
                () if situation.planned.contains(&agent_idx) && timestep <= plan_ends => "plan",
                () => "model",
            };
            self.states.push([&situation.scenario_id, name], &scene, &moved_by)?;
            report.count(name, driven);
            self.rows.push(row(situation, name, driven, careful_survives));
            self.log(&situation.scenario_id, driven, out)?;
        }
        if let Some(saved) = drives.first().and_then(|driven| driven.saved.as_ref()) {
            let folder = out.join(STATES_DIR);
            fs_err::create_dir_all(&folder)?;
            // Ids are hexadecimal, but those of a foreign corpus need not be.
            let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            let name = situation.scenario_id.replace(|c: char| !is_plain(c), "_");
            let (path, text) = (folder.join(format!("{name}.json")), saved.to_json()?);
            write_atomically::<Error>(&path, |file| Ok(file.write_all(text.as_bytes())?))?;
            report.n_saved += 1;
        }
        Ok(())
    }

    /// Adds what the driver said in a scenario to the log.
    fn log(&mut self, scenario_id: &str, driven: &Driven, out: &Path) -> Result<()> {
        if driven.said.is_empty() {
            return Ok(());
        }
        let log = match &mut self.log {
            Some(log) => log,
            None => self.log.insert(AtomicFile::create(&out.join(PLANNER_LOG))?),
        };
        Ok(writeln!(log, "== {scenario_id}: {}\n{}", driven.outcome.name(), driven.said.trim_end())?)
    }
}

/// The row of a drive.
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
