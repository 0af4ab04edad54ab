//! The page of a drive, for people: the failures that matter, and both drives to play side by side.

use super::rates::has_failed;
use super::report::DriveReport;
use crate::coverage::{Tag, Tags};
use crate::quantile::quantile;
use crate::report::{DriveCell, DriveGrid, DrivesPage, Fact, PlainTable, SceneCard};
use crate::scenario::DriveRow;
use crate::scene::Roles;
use crate::simulate::{Driven, Outcome, Situation};
use std::collections::BTreeMap;

/// The most scenarios drawn.
const MOST_DRAWN: usize = 50;
/// Intervals of a parameter in a heat map, with equally many scenarios, and the fewest scenarios for one.
const N_PARTS: usize = 4;
const LEAST_SCENARIOS: usize = 12;
/// The parameters that tell most about how hard an event is, in this order; others follow by name.
const TELLING: [&str; 5] = ["gap_m", "relative_speed_mps", "time_to_arrival_s", "max_deceleration_mps2", "min_ttc_s"];

/// Cards of the failures that the careful driver avoids, hardest first.
#[derive(Default)]
pub(super) struct Cards(Vec<(f64, SceneCard)>);

impl Cards {
    /// Adds the drives of the driver under test (`asked`) and of the careful one, if they matter, with the command that
    /// drives them `again`.
    pub(super) fn offer(
        &mut self,
        situation: &Situation,
        again: &str,
        asked: (&str, &Driven),
        careful: (&str, &Driven),
    ) {
        if !asked.1.outcome.is_failure() || careful.1.outcome != Outcome::Survived {
            return;
        }
        let id_of = |idx: usize| situation.scene.tracks[idx].id.clone();
        let others = situation.planned.iter().map(|idx| ("other".to_owned(), id_of(*idx)));
        let roles: Roles = [("driven".to_owned(), id_of(situation.ego_idx))].into_iter().chain(others).collect();
        let drives = [careful, asked].map(|(name, driven)| {
            let outcome = driven.outcome.name().replace('_', " ");
            let why = driven.why.as_ref().map(|why| format!(" ({why})")).unwrap_or_default();
            (format!("{name}: {outcome}{why}"), situation.driven(&driven.world))
        });
        let braking_mps2 = careful.1.max_braking_mps2;
        let behavior = situation.behavior.as_deref().unwrap_or("scenario").replace('_', " ");
        let title = format!(
            "{behavior} {}, {}: the careful driver brakes with up to {braking_mps2:.1} m/s²",
            situation.scenario_id, situation.scene.source.place
        );
        let parameters = situation.parameters.iter().map(|(name, value)| Fact::new(name, format!("{value:.2}")));
        let facts = [Fact::new("Again", again)].into_iter().chain(parameters).collect();
        self.0
            .push((braking_mps2, SceneCard::of_drives((situation.scenario_id.clone(), title), facts, &drives, &roles)));
        self.0.sort_by(|(a, one), (b, other)| b.total_cmp(a).then_with(|| one.id.cmp(&other.id)));
        self.0.truncate(MOST_DRAWN);
    }

    /// The page of these cards, the report, the rows of `asked` and the tags of scenarios.
    pub(super) fn page(
        self,
        report: &DriveReport,
        rows: &[DriveRow],
        asked: &str,
        tags: &BTreeMap<String, Tags>,
    ) -> DrivesPage {
        let steady = report.n_survived_at_constant_velocity.map(|n| Fact::new("Survived at constant velocity, too", n));
        let median = report.margins.as_ref().map(|margins| {
            let [own, careful] = margins.median_delay_s;
            let delays = format!("{own:.1} s by this driver, {careful:.1} s by the careful one");
            Fact::new("Delay of the others survived, median", delays)
        });
        let sooner = report.margins.as_ref().map(|margins| {
            let sooner = format!("{} of {}, later in {}", margins.n_sooner, margins.n_scenarios, margins.n_later);
            Fact::new("Fails at a shorter delay than the careful driver", sooner)
        });
        let counts = [
            Fact::new("Driver", &report.ego),
            Fact::new("Scenarios", report.n_scenarios),
            Fact::new("Failed", report.failures.n_failed),
            Fact::new("Of these, the careful driver survives", report.failures.n_avoidable),
            Fact::new("Hit in the rear", report.failures.n_hit_in_rear),
        ];
        let more = [steady, median, sooner].into_iter().flatten();
        let facts = counts.into_iter().chain(more).chain([Fact::new("Seed", report.seed)]).collect();
        let mut by_behavior: BTreeMap<&str, Vec<&DriveRow>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.driver == asked) {
            by_behavior.entry(row.behavior.as_deref().unwrap_or("none")).or_default().push(row);
        }
        DrivesPage {
            title: format!("Drives of {}", report.ego),
            facts,
            tables: rates(report).into_iter().chain([outcomes(report), behaviors(report), traffic(report)]).collect(),
            grids: (surroundings(&by_behavior, tags).into_iter())
                .chain(by_behavior.iter().filter_map(|(behavior, rows)| grid(behavior, rows)))
                .collect(),
            n_matter: report.that_matter.len(),
            scenes: self.0.into_iter().map(|(_, card)| card).collect(),
        }
    }
}

/// Failures in 1,000 km, by bucket; `None` if they were not asked for.
fn rates(report: &DriveReport) -> Option<PlainTable> {
    let columns = [
        "Place and bucket",
        "Happens in 1,000 km",
        "Rate",
        "Failed",
        "Failures in 1,000 km",
        "Careful driver",
        "Of all",
        "Of the interval",
    ];
    let mut table = PlainTable::new("Failures in 1,000 km: rates of events times shares that fail", &columns);
    for at in report.rates.as_ref()? {
        let n: u64 = at.buckets.iter().map(|bucket| bucket.n_scenarios).sum();
        let n_failed: u64 = at.buckets.iter().map(|bucket| bucket.n_failed).sum();
        let [own, careful] =
            [at.per_1000_km, at.careful_per_1000_km].map(|rate| rate.map_or_else(String::new, |rate| rate.to_string()));
        let none = String::new;
        table.push(vec![at.place.clone(), none(), none(), format!("{n_failed} of {n}"), own, careful, none(), none()]);
        for bucket in &at.buckets {
            table.push(vec![
                bucket.name().replace('_', " "),
                bucket.rate.to_string(),
                bucket.rate_source.to_owned(),
                format!("{} of {}", bucket.n_failed, bucket.n_scenarios),
                bucket.per_1000_km.to_string(),
                bucket.careful_per_1000_km.to_string(),
                format!("{:.0} %", 100.0 * bucket.of_rate),
                format!("{:.0} %", 100.0 * bucket.of_interval),
            ]);
        }
    }
    for at in report.split_rates.iter().flatten() {
        let all = ("by loops".to_owned(), [at.per_1000_km, at.careful_per_1000_km]);
        let agree = at.agree.map_or("", |[own, _]| if own { ", as by buckets" } else { ", not as by buckets" });
        let in_buckets = (format!("by loops, in events of the buckets{agree}"), at.in_buckets);
        let others = at
            .others
            .iter()
            .map(|(outcome, rates)| (format!("by loops, others: {}", outcome.replace('_', " ")), *rates));
        for (what, rates) in [all, in_buckets].into_iter().chain(others) {
            let (none, [own, careful]) = (String::new, rates.map(|rate| rate.to_string()));
            let place = format!("{} {what}", at.place).trim_start().to_owned();
            table.push(vec![place, none(), none(), none(), own, careful, none(), none()]);
        }
    }
    Some(table)
}

fn outcomes(report: &DriveReport) -> PlainTable {
    let mut table = PlainTable::new("Outcomes", &["Driver", "Outcome", "Scenarios"]);
    for (driver, outcomes) in &report.outcomes {
        for (outcome, n) in outcomes {
            table.push(vec![driver.clone(), outcome.replace('_', " "), n.to_string()]);
        }
    }
    table
}

fn behaviors(report: &DriveReport) -> PlainTable {
    let columns = [
        "Behavior",
        "Scenarios",
        "Failed",
        "Avoidable",
        "Hit",
        "Hit in the rear",
        "Careful driver fails",
        "Event happens",
        "Event avoided",
    ];
    let mut table = PlainTable::new("Failures by behavior", &columns);
    for (behavior, f) in &report.by_behavior {
        let counts = [f.n_scenarios, f.n_failed, f.n_avoidable, f.n_hit, f.n_hit_in_rear, f.n_careful_failed];
        let counts = counts.into_iter().chain([f.n_event_happens, f.n_event_avoided]);
        let cells = counts.map(|n| n.to_string());
        table.push([behavior.replace('_', " ")].into_iter().chain(cells).collect());
    }
    table
}

fn traffic(report: &DriveReport) -> PlainTable {
    let columns = [
        "Driver",
        "Seconds",
        "Agents per recorded one",
        "Arrived",
        "Left",
        "Collided per 1,000 s",
        "Share that stands",
    ];
    let mut table = PlainTable::new("Traffic over time", &columns);
    let per = |part: f64, whole: f64| if whole > 0.0 { format!("{:.2}", part / whole) } else { "–".to_owned() };
    for (driver, traffic) in &report.traffic {
        for (band, [from_s, to_s]) in report.bands_s.iter().enumerate().filter(|(i, _)| traffic.driven_s[*i] > 0.0) {
            table.push(vec![
                driver.clone(),
                if band + 1 < report.bands_s.len() {
                    format!("{from_s} to {to_s}")
                } else {
                    format!("{from_s} and more")
                },
                per(traffic.agent_s[band], traffic.agent_s_as_recorded[band]),
                format!("{} ({} as recorded)", traffic.n_arrived[band], traffic.n_arrived_recorded[band]),
                traffic.n_left[band].to_string(),
                per(1000.0 * traffic.n_collided[band] as f64, traffic.agent_s[band]),
                per(traffic.standing_s[band], traffic.agent_s[band]),
            ]);
        }
    }
    table
}

/// The failures by the two most telling parameters; `None` if there are fewer than two, or too few scenarios.
fn grid(behavior: &str, rows: &[&DriveRow]) -> Option<DriveGrid> {
    let values = |name: &str| {
        let mut values: Vec<f64> = rows.iter().filter_map(|row| row.parameters.get(name).copied()).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let mut names: Vec<&String> = rows.first()?.parameters.keys().collect();
    let varies = |name: &str| values(name).first() != values(name).last();
    names.retain(|name| values(name).len() == rows.len() && !name.contains("length") && varies(name));
    names.sort_by_key(|name| (TELLING.iter().position(|telling| telling == name).unwrap_or(TELLING.len()), *name));
    let [across, down] = [names.first()?.as_str(), names.get(1)?.as_str()];
    let ranges = [across, down].map(|name| {
        let (values, bound) = (values(name), |i: usize| i as f64 / N_PARTS as f64);
        let part = |i: usize| Some([quantile(&values, bound(i))?, quantile(&values, bound(i + 1))?]);
        (0..N_PARTS).filter_map(part).collect::<Vec<_>>()
    });
    let place = |row: &DriveRow, ranges: &[[f64; 2]], name: &str| {
        let value = *row.parameters.get(name)?;
        ranges.iter().position(|[_, high]| value <= *high)
    };
    let mut cells = vec![vec![DriveCell::default(); N_PARTS]; N_PARTS];
    for row in rows {
        let at = place(row, &ranges[0], across).zip(place(row, &ranges[1], down));
        let Some(cell) = at.and_then(|(x, y)| cells.get_mut(y)?.get_mut(x)) else { continue };
        count(cell, row);
    }
    let (axes, names) =
        ([across, down].map(str::to_owned), ranges.map(|r| r.into_iter().map(DriveGrid::range).collect()));
    (rows.len() >= LEAST_SCENARIOS).then(|| DriveGrid { title: behavior.to_owned(), axes, names, cells })
}

/// The failures by behavior and tag; `None` without any tag.
fn surroundings(by_behavior: &BTreeMap<&str, Vec<&DriveRow>>, tags: &BTreeMap<String, Tags>) -> Option<DriveGrid> {
    let mut cells: BTreeMap<Tag, Vec<DriveCell>> = BTreeMap::new();
    for (column, row) in by_behavior.values().enumerate().flat_map(|(i, rows)| rows.iter().map(move |row| (i, row))) {
        for tag in tags.get(&row.scenario_id).into_iter().flat_map(|tags| tags.each()) {
            let of_tag = cells.entry(tag).or_insert_with(|| vec![DriveCell::default(); by_behavior.len()]);
            of_tag.get_mut(column).into_iter().for_each(|cell| count(cell, row));
        }
    }
    let behaviors = by_behavior.keys().map(|behavior| behavior.replace('_', " ")).collect();
    let rows = cells.keys().map(|tag| format!("{}: {}", tag.attribute().name, tag.value()).replace('_', " ")).collect();
    let (axes, names) = (["behavior", "surroundings"].map(str::to_owned), [behaviors, rows]);
    let title = "By surroundings".to_owned();
    (!cells.is_empty()).then(|| DriveGrid { title, axes, names, cells: cells.into_values().collect() })
}

fn count(cell: &mut DriveCell, row: &DriveRow) {
    let has_failed = has_failed(row);
    cell.n += 1;
    cell.n_failed += u64::from(has_failed);
    cell.n_avoidable += u64::from(has_failed && row.careful_survives == Some(true));
    cell.n_careful_failed += u64::from(row.careful_survives == Some(false));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::render_drives;
    use crate::scene::Scene;
    use crate::scene::testing::{Drive, scene};
    use crate::simulate::Traffic;
    use std::sync::Arc;

    #[test]
    fn a_heat_map_counts_failures_and_shows_where_the_careful_driver_fails_too() {
        // A gap of 0 to 15 m at two speeds: the planner fails below 6 m, the careful driver below 3 m.
        let rows: Vec<DriveRow> = (0..32)
            .map(|i| (f64::from(i / 2), f64::from(i % 2)))
            .map(|(gap_m, relative_speed_mps)| DriveRow {
                behavior: Some("cut_in".to_owned()),
                driver: "planner".to_owned(),
                outcome: if gap_m < 6.0 { "hit" } else { "survived" }.to_owned(),
                careful_survives: Some(gap_m >= 3.0),
                parameters: [("gap_m", gap_m), ("relative_speed_mps", relative_speed_mps), ("ego_length_m", 4.0)]
                    .map(|(name, value)| (name.to_owned(), value))
                    .into(),
                ..DriveRow::default()
            })
            .collect();
        let grid = grid("cut_in", &rows.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(grid.axes, ["gap_m", "relative_speed_mps"].map(str::to_owned));
        let sums = (0..N_PARTS).map(|x| {
            grid.cells.iter().map(|row| row[x]).fold([0; 4], |sum, cell| {
                let cell = [cell.n, cell.n_failed, cell.n_avoidable, cell.n_careful_failed];
                [0, 1, 2, 3].map(|i| sum[i] + cell[i])
            })
        });
        assert_eq!(sums.collect::<Vec<_>>(), [[8, 8, 2, 6], [8, 4, 4, 0], [8, 0, 0, 0], [8, 0, 0, 0]]);
        let report = DriveReport::new(&crate::drive::EgoDriver::from_name("idm"), None, 1, "m");
        let none = Scene { lanes: Arc::default(), ..scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]) };
        let tags = BTreeMap::from([(rows[0].scenario_id.clone(), Tags::of(&none))]);
        let page = Cards::default().page(&report, &rows, "planner", &tags);
        let (names, cells) = (&page.grids[0].names, &page.grids[0].cells);
        assert!(names[0] == ["cut in"] && names[1][0] == "junction: unknown" && names[1].len() == 5, "{names:?}");
        assert!(cells.iter().all(|row| row[0].n == 32 && row[0].n_failed == 12), "{cells:?}");
        let page = render_drives(&page);
        assert!(page.contains("short beyond") && page.contains("cut in") && !page.contains("<article"));
        assert!(page.contains("survives 0 scenarios that this driver does not.") && !page.contains("come first"));
    }

    #[test]
    fn traffic_is_told_by_stretch_as_far_as_it_was_driven() {
        let mut report = DriveReport::new(&crate::drive::EgoDriver::from_name("idm"), None, 1, "m");
        let driven = Traffic {
            driven_s: [20.0, 0.0, 0.0, 5.0],
            agent_s: [500.0, 0.0, 0.0, 40.0],
            agent_s_as_recorded: [400.0, 0.0, 0.0, 0.0],
            standing_s: [125.0, 0.0, 0.0, 0.0],
            n_arrived: [7, 0, 0, 2],
            n_arrived_recorded: [4, 0, 0, 1],
            n_left: [3, 0, 0, 0],
            n_collided: [2, 0, 0, 0],
            ..Traffic::default()
        };
        report.traffic.insert("idm".to_owned(), driven);
        let rows: Vec<Vec<String>> = traffic(&report).rows.into_iter().map(|row| row.cells).collect();
        assert_eq!(
            rows,
            [
                ["idm", "0 to 2", "1.25", "7 (4 as recorded)", "3", "4.00", "0.25"],
                ["idm", "8 and more", "–", "2 (1 as recorded)", "0", "0.00", "0.00"],
            ]
        );
    }
}
