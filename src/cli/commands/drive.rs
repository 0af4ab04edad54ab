//! `djinn drive` and `djinn score`: a driving function in the scenarios of a corpus, with others that answer to it or
//! do not.

use super::{begins_anew, use_threads};
use crate::cli::args::{DriveArgs, DriveGates, OutputArgs, ScoreArgs};
use crate::cli::printer::Printer;
use crate::cli::progress::TerminalProgress;
use crate::cli::signals;
use crate::drive::{DriveConfig, DriveReport, EgoDriver, Origin, SplitFailures, drive_corpus, score as score_planned};
use crate::engine::{ComputeChoice, Failure, Result, version};
use crate::generate::Futures;
use crate::pipeline::driven_by::open_model;
use crate::scenario::EgoChoice;
use crate::simulate::{RatesConfig, RolloutConfig, World};
use std::fmt::Write;
use std::path::Path;

pub(in crate::cli) fn drive(args: &DriveArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    use_threads(output, 0)?;
    let from = args.from.as_deref().map(World::read).transpose()?;
    let seed = from.as_ref().map_or(args.seed, |world| world.seed);
    let selection = args.chosen.selection();
    let from = from.map_or(Origin::Scenarios(&selection), Origin::State);
    let compute = ComputeChoice { device: args.device, precision: args.precision }.open()?;
    let model = open_model(args.model.as_deref(), &args.corpus, &compute)?;
    let futures = Futures::new(&model, seed, &compute.device)?;
    let config = DriveConfig {
        ego: EgoDriver::from_name(&args.ego),
        rollout: RolloutConfig { horizon_s: args.horizon_s, replan_s: args.replan_s },
        time_limit_s: args.time_limit_s,
        save_at: args.save_at,
        bisects: args.bisect,
        rates: args.rates,
        split: args.loops.map(|loops| RatesConfig {
            loops,
            horizon_s: args.horizon_s,
            replan_s: args.replan_s,
            levels: args.levels.clone(),
            copies: args.copies,
            ..RatesConfig::default()
        }),
        n_workers: rayon::current_num_threads(),
        program: version()?,
        scenes: args.scenes.clone(),
    };
    signals::leaves_resumable(format!(
        "finished drives are kept in {}.drives; run the same command again to continue",
        args.out.display()
    ));
    let progress = TerminalProgress::new(output, *printer);
    let ego = EgoChoice::from_name(&args.chosen.ego_track);
    let report = drive_corpus((&args.corpus, &args.out), &from, &ego, &config, &futures, &progress)?;
    if args.save_at.is_some() {
        printer.message(format_args!("{} states were saved", report.n_saved));
    }
    tell(&report, &args.gates, &args.out, printer)
}

pub(in crate::cli) fn score(args: &ScoreArgs, output: &OutputArgs, printer: &Printer) -> Result<()> {
    use_threads(output, 0)?;
    begins_anew(&args.out);
    let progress = TerminalProgress::new(output, *printer);
    let ego = EgoChoice::from_name(&args.chosen.ego_track);
    let paths = (args.corpus.as_path(), args.planned.as_path(), args.out.as_path());
    let report = score_planned(paths, &args.chosen.selection(), &ego, &progress)?;
    tell(&report, &args.gates, &args.out, printer)
}

/// Prints the figures, and fails if a gate is not met.
fn tell(report: &DriveReport, gates: &DriveGates, out: &Path, printer: &Printer) -> Result<()> {
    for (why, n) in &report.left_out {
        printer.message(format_args!("{n} scenarios were left out: each {why}"));
    }
    printer.data(&text(report))?;
    printer.message(format_args!("the drives are in {}", out.display()));
    let DriveGates { max_failures, max_avoidable, max_unjudged } = *gates;
    // A gate over a part is not met, unless that is asked for.
    let max_unjudged = max_unjudged.or(max_failures.or(max_avoidable).map(|_| 0));
    let gates = [
        ("max-failures", report.failures.n_failed, max_failures),
        ("max-avoidable", report.failures.n_avoidable, max_avoidable),
        ("max-unjudged", report.n_unjudged, max_unjudged),
    ];
    if let Some((gate, n, most)) =
        gates.into_iter().find_map(|(gate, n, most)| Some((gate, n, most.filter(|most| n > *most)?)))
    {
        return Err(Failure::gate(format_args!("--{gate}: {n} scenarios, expected at most {most}")));
    }
    match max_unjudged.is_some() && report.n_judged() == 0 {
        true => Err(Failure::gate("no scenario was judged: in none had the model a future for the others")),
        false => Ok(()),
    }
}

/// The outcomes, and the hardest scenarios that matter.
fn text(report: &DriveReport) -> String {
    const N_SHOWN: usize = 10;
    let mut text = String::new();
    // Writing to a string cannot fail.
    for (driver, outcomes) in &report.outcomes {
        let outcomes: Vec<String> = outcomes.iter().map(|(outcome, n)| format!("{n} {outcome}")).collect();
        let _ = writeln!(text, "{driver}: {}", outcomes.join(", "));
    }
    let failures = &report.failures;
    let _ = writeln!(
        text,
        "{} of {} scenarios fail ({} hit in the rear); the careful driver survives {} of these",
        failures.n_failed,
        report.n_judged(),
        failures.n_hit_in_rear,
        failures.n_avoidable
    );
    if let Some(n_survived) = report.n_survived_at_constant_velocity {
        let _ = writeln!(text, "{n_survived} of {} are survived at constant velocity, too", report.n_judged());
    }
    if report.n_unjudged > 0 {
        let n_all = report.n_judged() + report.n_unjudged;
        let _ = writeln!(text, "{} of {n_all} chosen scenarios were not judged", report.n_unjudged);
    }
    let _ = writeln!(
        text,
        "the event happens in {} scenarios; the driver avoids {} collisions and near misses in time",
        failures.n_event_happens, failures.n_event_avoided
    );
    if let Some(margins) = &report.margins {
        let [own, careful] = margins.median_delay_s;
        let _ = writeln!(
            text,
            "with the others of {} events later, it fails before the careful driver in {} and after it in {}; the \
             median delay survived is {own:.1} s for it, {careful:.1} s for the careful driver",
            margins.n_scenarios, margins.n_sooner, margins.n_later
        );
    }
    write_rates(&mut text, report);
    for matters in report.that_matter.iter().take(N_SHOWN) {
        let why = matters.why.as_deref().unwrap_or_default();
        let _ = writeln!(text, "  {}: {} ({why})", matters.scenario_id, matters.outcome);
    }
    if report.that_matter.len() > N_SHOWN {
        let _ = writeln!(text, "  … and {} more", report.that_matter.len() - N_SHOWN);
    }
    text
}

/// How often the driver fails at each place.
fn write_rates(text: &mut String, report: &DriveReport) {
    for at in report.rates.iter().flatten() {
        if let Some((own, careful)) = at.per_1000_km.zip(at.careful_per_1000_km) {
            let _ =
                writeln!(text, "at {}, it fails {own} times in 1,000 km, the careful driver {careful} times", at.place);
        }
        if let Some((most, widest)) = at.buckets.first().zip(at.widest()) {
            let _ = writeln!(
                text,
                "  {:.0} % of that is from {}; {} makes {:.0} % of the interval",
                100.0 * most.of_rate,
                most.name(),
                widest.name(),
                100.0 * widest.of_interval
            );
        }
        if at.n_without_rate > 0 {
            let _ = writeln!(
                text,
                "  {} scenarios have no rate or aim at hard events, and are not in it",
                at.n_without_rate
            );
        }
    }
    for at in report.split_rates.iter().flatten() {
        let SplitFailures { place, per_1000_km, careful_per_1000_km, in_buckets: [own, careful], .. } = at;
        let place = if place.is_empty() { "all places" } else { place };
        let _ = writeln!(
            text,
            "by loops at {place}, it fails {per_1000_km} times in 1,000 km, the careful driver {careful_per_1000_km} \
             times"
        );
        let agree = at.agree.map_or("", |[own, _]| {
            if own { ", which agrees with the buckets" } else { ", which does not agree with the buckets" }
        });
        let _ = writeln!(text, "  in events of the buckets {own}{agree}, the careful driver {careful}");
        for (outcome, [own, careful]) in &at.others {
            let _ = writeln!(text, "  others: {outcome} {own}, the careful driver {careful}");
        }
    }
    if report.rates.iter().flatten().all(|at| at.buckets.is_empty()) && report.rates.is_some() {
        let _ = writeln!(
            text,
            "no scenario has a rate and is a sample of its bucket: evaluate the corpus again, with [mine]"
        );
    }
}
