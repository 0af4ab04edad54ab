//! Several processes train one model: which of them is this, do they fit together, and what does each do?
//!
//! They are started with the same command and find their numbers in the environment. The first one, rank 0, runs the stage as if it were
//! alone: it holds the lock of the run folder and writes. The others compute their share and write nothing.

use super::config::{PipelineConfig, TrainConfig};
use super::graph::{Action, PlannedStage, assist};
use super::identity::Identity;
use super::{Blame, Failure, Result, StageContext, StageId};
use crate::progress::Progress;
use crate::train::{Alone, Exchange, JoinError, Lost, Meeting, Seat, check_ranks, join};
use std::path::Path;
use std::time::Duration;

/// The place of this process among those that train, if the environment says that there are several and one of the stages is trained.
///
/// # Errors
/// When the environment says only a part of it, or more than one stage is to be run.
pub fn seat(stages: &[StageId]) -> Result<Option<Seat>> {
    if !stages.iter().any(|stage| stage.facts().trains) {
        return Ok(None);
    }
    let seat = read_seat(&|name| std::env::var(name).ok().filter(|value| !value.is_empty()))?;
    match (&seat, stages) {
        (Some(Seat { n_ranks, .. }), [_, _, ..]) => Err(Failure::input_message(format_args!(
            "{n_ranks} processes were started, which can train one stage together and not run several"
        ))
        .with_hint(
            "choose it, such as --stage train_denoiser, or unset WORLD_SIZE to run all of them with one process",
        )),
        _ => Ok(seat),
    }
}

/// The place that these variables say. A batch script of Slurm has a number of tasks as well: it counts where the ranks have been told
/// where to meet.
fn read_seat(read: &dyn Fn(&str) -> Option<String>) -> Result<Option<Seat>> {
    let number = |name: &'static str| -> Result<Option<usize>> {
        let refused = |text: &str| {
            Failure::input_message(format_args!("{name} is \"{text}\" in the environment, expected a whole number"))
        };
        read(name).map(|text| text.trim().parse().map_err(|_| refused(&text))).transpose()
    };
    let n_ranks = match number("WORLD_SIZE")? {
        None if read("MASTER_ADDR").is_some() => number("SLURM_NTASKS")?,
        found => found,
    };
    let Some(n_ranks) = n_ranks.filter(|n_ranks| *n_ranks > 1) else { return Ok(None) };
    let missing = |what: &str| {
        Failure::input_message(format_args!("{n_ranks} processes train together, but {what} is not in the environment"))
            .with_hint("set RANK (from 0), WORLD_SIZE, MASTER_ADDR and MASTER_PORT for each of them, as in pipelines/CLUSTER.md")
    };
    let ranks = ["RANK", "SLURM_PROCID", "JOB_COMPLETION_INDEX"].map(number);
    let mut rank = None;
    for found in ranks {
        rank = rank.or(found?);
    }
    let rank = rank.ok_or_else(|| missing("RANK"))?;
    if rank >= n_ranks {
        let message =
            format_args!("RANK is {rank} in the environment, expected 0 to {} of {n_ranks} processes", n_ranks - 1);
        return Err(Failure::input_message(message));
    }
    let host = read("MASTER_ADDR").ok_or_else(|| missing("MASTER_ADDR"))?;
    let port = number("MASTER_PORT")?.ok_or_else(|| missing("MASTER_PORT"))?;
    let port = u16::try_from(port).ok().filter(|port| *port > 0).ok_or_else(|| {
        Failure::input_message(format_args!("MASTER_PORT is {port} in the environment, expected 1 to 65535"))
    })?;
    Ok(Some(Seat { rank, n_ranks, host, port }))
}

/// Number of parts in which the stage computes gradients; 1 where it trains nothing.
pub fn n_parts(config: &PipelineConfig, stage: StageId) -> usize {
    let TrainConfig { denoiser, distill, classifier, baseline } = &config.train;
    let (checkpoint, parts) = match stage {
        StageId::TrainDenoiser => denoiser.as_ref().map(|section| (&section.checkpoint, section.parts)),
        StageId::TrainDistill => distill.as_ref().map(|section| (&section.checkpoint, section.parts)),
        StageId::TrainClassifier => classifier.as_ref().map(|section| (&section.checkpoint, section.parts)),
        StageId::TrainBaseline => baseline.as_ref().map(|section| (&section.checkpoint, section.parts)),
        StageId::Ingest | StageId::Mine | StageId::Generate | StageId::Evaluate | StageId::Report => None,
    }
    .unwrap_or((&None, None));
    parts.filter(|_| checkpoint.is_none()).unwrap_or(1)
}

/// Brings together the ranks that train the planned stage. A process that trains alone, or finds it trained, waits for nobody.
///
/// # Errors
/// When ranks do not fit together, or do not come in time.
pub fn meet(
    seat: Option<&Seat>,
    config: &PipelineConfig,
    planned: &[PlannedStage<'_>],
    progress: &dyn Progress,
) -> Result<Box<dyn Exchange>> {
    let is_trained =
        |planned: &&PlannedStage<'_>| planned.action != Action::Reuse && planned.expected.stage.facts().trains;
    let (Some(seat), Some(planned)) = (seat, planned.iter().find(is_trained)) else { return Ok(Box::new(Alone)) };
    let (stage, n_parts) = (planned.expected.stage, n_parts(config, planned.expected.stage));
    check_ranks(n_parts, seat.n_ranks).map_err(|why| {
        let key = format!("{}.parts", stage.facts().section);
        Failure::input_message(format_args!("{key} is {n_parts}: {why}"))
            .with_hint(format!("set {key}, which changes the model's bytes, or start another number of processes"))
    })?;
    progress.start("join", 0, "ranks");
    let own = Identity::own(planned.expected.clone(), config.run.compute())?;
    let difference = |theirs: &Identity| theirs.difference(&own);
    let patience = Duration::from_secs(config.cluster.clone().unwrap_or_default().ranks_wait_s.into());
    let exchange = join(seat, &Meeting { own: own.clone(), difference: &difference, patience })?;
    progress.finish();
    Ok(Box::new(exchange))
}

/// What a rank other than the first does: its share of the training that is planned, unless that is done already. It writes nothing, and
/// stays until the first one has put the model in its place.
///
/// # Errors
/// Those of [`meet`] and of the training.
pub fn help(
    seat: &Seat,
    config: &PipelineConfig,
    root: &Path,
    planned: Vec<PlannedStage<'_>>,
    progress: &dyn Progress,
) -> Result<()> {
    let exchange = meet(Some(seat), config, &planned, progress)?;
    let Some(planned) = planned.into_iter().find(|planned| planned.action != Action::Reuse) else { return Ok(()) };
    let compute = config.run.compute().open()?;
    assist(&planned, &StageContext { root, compute: &compute, progress, exchange: exchange.as_ref() })?;
    progress.start("wait for rank 0", 0, "");
    let unwritten = |lost: Lost| Failure { blame: Blame::Later, ..Failure::fault(lost) };
    exchange
        .all_gather(&[])
        .map(drop)
        .map_err(|lost| unwritten(lost).context("rank 0 ended before the model was in its place"))
}

/// What rank 0 does once the model is in its place: it lets the others go. Were they gone before, it could not begin again without them.
pub fn dismiss(exchange: &dyn Exchange) {
    // Who is gone already is no longer needed.
    let _ = exchange.all_gather(&[]);
}

/// What does not fit is the user's to mend. Who has not come yet may come later.
impl From<JoinError> for Failure {
    fn from(error: JoinError) -> Self {
        let blame = match &error {
            JoinError::Refused(_) => Blame::Input,
            JoinError::Missing { refused, .. } if !refused.is_empty() => Blame::Input,
            JoinError::Missing { .. } | JoinError::NoAnswer { .. } | JoinError::Broken(_) => Blame::Later,
            JoinError::CannotListen { .. } => Blame::Fault,
        };
        let failure = Self { blame, ..Self::fault(error) };
        failure.with_hint(
            "start all ranks with the same command, program and pipeline file; cluster.ranks_wait_s is how long they wait for each other",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seat_of(variables: &[(&str, &str)]) -> Result<Option<Seat>> {
        let found =
            |name: &str| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned());
        read_seat(&found)
    }

    #[test]
    fn places_are_read_as_launchers_say_them() {
        let place = [("MASTER_ADDR", "node1"), ("MASTER_PORT", "29400")];
        let seat_at = |more: &[(&str, &str)]| seat_of(&[&place[..], more].concat()).unwrap();
        let expected = |rank, n_ranks| Some(Seat { rank, n_ranks, host: "node1".to_owned(), port: 29400 });
        assert_eq!(seat_at(&[("RANK", "3"), ("WORLD_SIZE", "4")]), expected(3, 4));
        assert_eq!(seat_at(&[("SLURM_PROCID", "0"), ("SLURM_NTASKS", "2")]), expected(0, 2));
        assert_eq!(seat_at(&[("JOB_COMPLETION_INDEX", "1"), ("WORLD_SIZE", "2")]), expected(1, 2));
        // What was said on purpose counts before what a launcher says of every job.
        let all = [("RANK", "1"), ("WORLD_SIZE", "2"), ("SLURM_PROCID", "5"), ("SLURM_NTASKS", "8")];
        assert_eq!(seat_at(&all), expected(1, 2));
        assert_eq!(seat_at(&[("RANK", "0"), ("WORLD_SIZE", "1")]), None);
    }

    #[test]
    fn a_process_alone_and_a_batch_script_are_no_ranks() {
        assert_eq!(seat_of(&[]).unwrap(), None);
        assert_eq!(seat_of(&[("SLURM_PROCID", "0"), ("SLURM_NTASKS", "4")]).unwrap(), None);
        assert_eq!(seat_of(&[("JOB_COMPLETION_INDEX", "2")]).unwrap(), None);
    }

    #[test]
    fn places_that_make_no_sense_are_refused_by_name() {
        let two = ("WORLD_SIZE", "2");
        for (variables, expected) in [
            (vec![two], "2 processes train together, but RANK is not in the environment"),
            (vec![two, ("RANK", "2")], "RANK is 2 in the environment, expected 0 to 1 of 2 processes"),
            (vec![two, ("RANK", "0")], "but MASTER_ADDR is not in the environment"),
            (vec![two, ("RANK", "0"), ("MASTER_ADDR", "a")], "but MASTER_PORT is not in the environment"),
            (vec![("WORLD_SIZE", "two")], "WORLD_SIZE is \"two\" in the environment, expected a whole number"),
            (
                vec![two, ("RANK", "0"), ("MASTER_ADDR", "a"), ("MASTER_PORT", "70000")],
                "MASTER_PORT is 70000 in the environment, expected 1 to 65535",
            ),
        ] {
            let failure = seat_of(&variables).unwrap_err();
            let said = failure.error.to_string();
            assert!(failure.blame == Blame::Input && said.contains(expected), "{said}");
        }
    }
}
