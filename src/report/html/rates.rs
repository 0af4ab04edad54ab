//! The section on rates: how often what was recorded happens.

use super::Section;
use super::plain::plain_table;
use crate::rates::{RateMethod, RateRow};
use crate::report::model::ReportModel;
use crate::report::number::{count, value};
use crate::report::plain::PlainTable;
use crate::report::svg::{RateMark, rate_chart};
use crate::statistics::{Estimate, Interval};
use maud::{Markup, html};

/// Dispersions from which on events are said to come in clusters.
const CLUSTERED: f64 = 1.5;

/// The section; `None` without rates.
pub(super) fn section(model: &ReportModel) -> Option<Section> {
    let rows: Vec<&RateRow> = model.rates.iter().filter(|row| row.split.is_empty()).collect();
    let (everywhere, by_place): (Vec<&RateRow>, Vec<&RateRow>) = rows.iter().partition(|row| row.place.is_empty());
    // A single place is everywhere.
    let (first, others) = if everywhere.is_empty() { (by_place, Vec::new()) } else { (everywhere, by_place) };
    let exposure = first.first()?;
    let body = html! {
        p {
            (value(exposure.observed_h)) " hours in " (count(exposure.n_recordings)) " recordings, with "
            (value(exposure.motorized_km)) " km of motorized road users. Every moment and every event counts once, \
            however many scenes show it; generated scenarios never count."
        }
        (picture(&first))
        (table("Rates with their 95 % intervals", &first))
        @if !others.is_empty() { details { summary { "By place" } (table("Rates at each place", &others)) } }
        @if !model.calibration.is_empty() { (calibration(model)) }
        (claims(model))
    };
    Some(Section::new("rates", "How often it happens", body))
}

/// What is known, what is inferred, and what nobody may read into the figures.
fn claims(model: &ReportModel) -> Markup {
    let is_given = |method| model.rates.iter().chain(&model.modeled).any(|row| row.method == method);
    html! {
        ul class="note" {
            li {
                b { "Known: " }
                "rates of recorded events, which were counted. The interval holds the true rate 19 times of 20, also \
                where events come in clusters, unless there is one recording. Where none was found, it says how often \
                it may happen nevertheless."
            }
            @if is_given(RateMethod::Extrapolated) {
                li {
                    b { "Extrapolated (hollow): " }
                    "rates of what was recorded twice or less, from less severe events. Take the interval for an order \
                    of magnitude. A limit that hardly any event reaches, such as that of brakes, is not seen."
                }
            }
            @if is_given(RateMethod::Modeled) {
                li {
                    b { "Modeled: " }
                    "rates in simulated traffic. That it agrees with recordings was checked for all events of a \
                    behavior, not for the rare ones among them."
                }
            }
            li {
                b { "Not claimed: " }
                "rates of other places, or of times and weather without recordings; a rate where the last column says \
                why there is none; and how often generated scenarios happen."
            }
        }
    }
}

/// The rates in closed loops of the unguided model, and whether they are as recorded.
fn calibration(model: &ReportModel) -> Markup {
    let columns = ["Behavior", "Place", "Held-out events", "In 1,000 km", "Modeled", "Factor", "Used"];
    let mut plain = PlainTable::new("Modeled against recorded rates of held-out recordings", &columns);
    let range = |Estimate { value: found, interval }: Estimate| match found > 0.0 {
        true => format!("{} ({} to {})", value(found), value(interval.low), value(interval.high)),
        false => format!("below {}", value(interval.high)),
    };
    for one in &model.calibration {
        let used = match () {
            () if !one.is_judged() => "too few to tell",
            () if one.is_met() => "yes",
            () => "no",
        };
        plain.push(vec![
            one.behavior.clone(),
            if one.place.is_empty() { "all".to_owned() } else { one.place.clone() },
            count(one.n_recorded),
            range(one.recorded),
            range(one.modeled),
            one.factor.map_or_else(String::new, range),
            used.to_owned(),
        ]);
    }
    let given: Vec<&RateRow> = model.modeled.iter().collect();
    html! {
        p {
            "Closed loops of the unguided model go on from held-out scenes. A rate of theirs is given where it agrees \
            with the recorded one of the behavior within a factor of 1.5; its interval allows for the difference. \
            Guided samples and templates never enter a rate."
        }
        details { summary { "Does the model do it as often?" } (plain_table(&plain)) }
        @if !given.is_empty() { details { summary { "Modeled rates" } (table("Rates by the model", &given)) } }
    }
}

/// The drawing: per 1,000 km, or per hour where nobody motorized was recorded.
pub(in crate::report) fn picture(rows: &[&RateRow]) -> Markup {
    let has_km = rows.iter().all(|row| row.per_1000_km.is_some());
    let mark = |row: &&RateRow| {
        let by_hour = (row.rate_per_hour, row.per_hour);
        let (rate, interval) =
            if has_km { row.rate_per_1000_km.zip(row.per_1000_km).unwrap_or(by_hour) } else { by_hour };
        let is_extrapolated = row.method == RateMethod::Extrapolated;
        RateMark { label: label(row), rate, interval, is_extrapolated }
    };
    let unit = if has_km { "events in 1,000 km of motorized road users" } else { "events an hour" };
    rate_chart("Rates of events, with their intervals", unit, &rows.iter().map(mark).collect::<Vec<_>>())
}

fn label(row: &RateRow) -> String {
    if row.within.is_empty() { row.behavior.clone() } else { format!("{} {}", row.behavior, row.within) }
}

fn table(caption: &str, rows: &[&RateRow]) -> Markup {
    let columns = ["Behavior", "Place", "Events", "An hour at a place", "In 1,000 km", "Known from"];
    let mut plain = PlainTable::new(caption, &columns);
    let range = |rate: f64, Interval { low, high }: Interval| match rate > 0.0 {
        true => format!("{} ({} to {})", value(rate), value(low), value(high)),
        false => format!("below {}", value(high)),
    };
    for row in rows {
        let of_km = row.rate_per_1000_km.zip(row.per_1000_km);
        plain.push(vec![
            label(row),
            row.place.clone(),
            count(row.n_events),
            range(row.rate_per_hour, row.per_hour),
            of_km.map_or_else(String::new, |(rate, interval)| range(rate, interval)),
            known_from(row),
        ]);
    }
    plain_table(&plain)
}

fn known_from(row: &RateRow) -> String {
    let what = match row.method {
        RateMethod::OverRecordings => match row.dispersion.filter(|dispersion| *dispersion >= CLUSTERED) {
            Some(dispersion) => {
                let wider = value(dispersion.sqrt());
                format!("{} recordings; clusters of events make the interval {wider} times wider", row.n_recordings)
            }
            None => format!("{} recordings", row.n_recordings),
        },
        RateMethod::OneRecording => "one recording, as if events were independent".to_owned(),
        RateMethod::NoneFound => "none found".to_owned(),
        RateMethod::Extrapolated => "extrapolated".to_owned(),
        RateMethod::Modeled => format!("the model, in {} km of closed loops", value(row.motorized_km)),
    };
    row.note.as_ref().map_or(what.clone(), |note| format!("{what}, {note}"))
}
