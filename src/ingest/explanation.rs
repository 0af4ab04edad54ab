//! Figures on recordings as they were understood, for people to compare with what they know.

use super::report::IngestReport;
use crate::geometry::{Vec2, angle_difference};
use crate::quantile::quantile;
use crate::scene::{AgentClass, Scene, State, Track};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};

/// Agents faster than this have a direction of motion, m/s.
const MOVING_MPS: f64 = 1.0;
/// If fewer of the moving vehicles drive along lanes, positions and map do not fit.
const MIN_ALONG_LANES: f64 = 0.5;
/// A vehicle this near to the center of a lane is on it, meters.
const ON_LANE_M: f64 = 2.0;

/// The first scenes of recordings in figures.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// Names and values, in order.
    facts: Vec<(&'static str, String)>,
    /// By class, in order.
    classes: Vec<ClassFacts>,
}

/// The agents of a class.
#[derive(Debug, Clone, PartialEq)]
struct ClassFacts {
    class: AgentClass,
    n_tracks: usize,
    /// Median length and width, meters; `None` if none is recorded.
    size_m: Option<[f64; 2]>,
    /// The 5th, 50th and 95th percentile of speeds, m/s.
    speeds_mps: [f64; 3],
    /// The 95th percentile of accelerations, m/s²: noise of positions shows in it.
    acceleration_mps2: f64,
    /// Median angle between heading and motion of moving agents, degrees.
    slip_deg: Option<f64>,
}

impl Explanation {
    /// Explains `scenes`, at least one, and the report on them.
    pub fn of(scenes: &[Scene], report: &IngestReport) -> Self {
        let places: BTreeSet<&str> = scenes.iter().map(|scene| scene.source.place.as_str()).collect();
        let files: BTreeSet<&str> = scenes.iter().map(|scene| scene.source.file.as_str()).collect();
        let first = scenes.first();
        let mut facts = vec![
            ("scenes", format!("{}, of {} at {}", scenes.len(), listed(&files), listed(&places))),
            ("left out", left_out(report)),
            (
                "time",
                first.map_or_else(String::new, |scene| {
                    let Scene { n_timesteps, n_history, dt_s, .. } = scene;
                    format!("{n_timesteps} timesteps of {dt_s} s, of which {n_history} are observed")
                }),
            ),
            ("positions", extent_of(scenes)),
        ];
        if let Some((share, along)) = on_lanes(scenes) {
            facts.push(("lanes", share));
            if along < MIN_ALONG_LANES {
                let doubt = "few vehicles drive along lanes: are positions, directions and map in one frame?";
                facts.push(("doubt", doubt.to_owned()));
            }
        }
        facts.extend(report.assumed.iter().map(|(what, n)| ("assumed", format!("{n} {}", what.replace('_', " ")))));
        Self { facts, classes: classes(scenes) }
    }
}

impl Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, value) in &self.facts {
            writeln!(f, "{name:<10} {value}")?;
        }
        writeln!(
            f,
            "\n{:<22} {:>7}  {:>13}  {:>24}  {:>17}  {:>12}",
            "class", "tracks", "median size", "speed 5, 50, 95 %", "acceleration 95 %", "off heading"
        )?;
        for facts in &self.classes {
            let ClassFacts { class, n_tracks, size_m, speeds_mps: [low, middle, high], slip_deg, .. } = facts;
            let acceleration = format!("{:.1} m/s2", facts.acceleration_mps2);
            let size =
                size_m.map_or_else(|| "none".to_owned(), |[length, width]| format!("{length:.1} x {width:.1} m"));
            let slip = slip_deg.map_or_else(|| "stands".to_owned(), |slip| format!("{slip:.1} deg"));
            let speeds = format!("{low:.1}, {middle:.1}, {high:.1} m/s");
            writeln!(
                f,
                "{:<22} {n_tracks:>7}  {size:>13}  {speeds:>24}  {acceleration:>17}  {slip:>12}",
                class.name()
            )?;
        }
        Ok(())
    }
}

fn listed(names: &BTreeSet<&str>) -> String {
    const N_NAMED: usize = 3;
    let named: Vec<&str> = names.iter().take(N_NAMED).copied().collect();
    let more = names.len().saturating_sub(N_NAMED);
    named.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

fn left_out(report: &IngestReport) -> String {
    let rejects = report.rejects.iter().map(|(reason, rejects)| {
        let first = rejects.examples.first().map_or("", String::as_str);
        format!("{} {} ({first})", rejects.count, reason.replace('_', " "))
    });
    let dropped = report.dropped.iter().map(|(what, n)| format!("{n} {}", what.replace('_', " ")));
    let all: Vec<String> = rejects.chain(dropped).collect();
    if all.is_empty() { "nothing".to_owned() } else { all.join("; ") }
}

fn tracks(scenes: &[Scene]) -> impl Iterator<Item = (&Scene, &Track)> {
    scenes.iter().flat_map(|scene| scene.tracks.iter().map(move |track| (scene, track)))
}

fn states(track: &Track) -> impl Iterator<Item = &State> {
    track.trajectory.valid().map(|(_, state)| state)
}

fn extent_of(scenes: &[Scene]) -> String {
    let (mut low, mut high) = (Vec2::new(f64::MAX, f64::MAX), Vec2::new(f64::MIN, f64::MIN));
    for (scene, track) in tracks(scenes) {
        for state in states(track) {
            let Vec2 { x, y } = scene.world_from_scene.point(state.position);
            (low, high) = (Vec2::new(low.x.min(x), low.y.min(y)), Vec2::new(high.x.max(x), high.y.max(y)));
        }
    }
    format!(
        "x from {:.1} to {:.1} m, y from {:.1} to {:.1} m, in the frame of the recording",
        low.x, high.x, low.y, high.y
    )
}

/// How many of the vehicles that move at present are on a lane and along it, and the latter's share; `None` without
/// lanes.
fn on_lanes(scenes: &[Scene]) -> Option<(String, f64)> {
    let (mut n, mut n_on, mut n_along) = (0_u32, 0_u32, 0_u32);
    for (scene, track) in
        tracks(scenes).filter(|(scene, track)| !scene.lanes.lanes().is_empty() && track.class.is_motorized())
    {
        let now = track.trajectory.get(scene.current_timestep()).filter(|state| state.velocity.norm() > MOVING_MPS);
        let Some(now) = now else { continue };
        let lanes = scene.lanes.lanes().iter().filter_map(|lane| lane.centerline.project(now.position));
        let near: Vec<f64> =
            lanes.filter(|place| place.offset_m.abs() < ON_LANE_M).map(|place| place.heading_rad).collect();
        n += 1;
        n_on += u32::from(!near.is_empty());
        let is_along =
            |heading_rad: &f64| angle_difference(*heading_rad, now.heading_rad).abs() < std::f64::consts::FRAC_PI_6;
        n_along += u32::from(near.iter().any(is_along));
    }
    let percent = |count: u32| 100.0 * f64::from(count) / f64::from(n);
    (n > 0).then(|| {
        let share = format!(
            "{:.0} % of moving vehicles are within {ON_LANE_M} m of the center of a lane, {:.0} % of all along it",
            percent(n_on),
            percent(n_along)
        );
        (share, f64::from(n_along) / f64::from(n))
    })
}

fn classes(scenes: &[Scene]) -> Vec<ClassFacts> {
    let mut of_class: BTreeMap<AgentClass, Vec<(&Scene, &Track)>> = BTreeMap::new();
    for (scene, track) in tracks(scenes) {
        of_class.entry(track.class).or_default().push((scene, track));
    }
    let facts = |(class, tracks): (AgentClass, Vec<(&Scene, &Track)>)| {
        let sizes = tracks.iter().filter_map(|(_, track)| track.extent);
        let (lengths, widths): (Vec<f64>, Vec<f64>) = sizes.map(|size| (size.length_m, size.width_m)).unzip();
        let all: Vec<&State> = tracks.iter().flat_map(|(_, track)| states(track)).collect();
        let speeds = sorted(all.iter().map(|state| state.velocity.norm()).collect());
        let moving = all.iter().filter(|state| state.velocity.norm() > MOVING_MPS);
        let slips = moving.map(|state| angle_difference(state.velocity.angle(), state.heading_rad).abs().to_degrees());
        let accelerations = tracks.iter().flat_map(|(scene, track)| {
            let velocities: Vec<Option<Vec2>> =
                track.trajectory.entries().iter().map(|state| state.map(|state| state.velocity)).collect();
            let gains = velocities.windows(2).filter_map(|pair| Some((pair[1]? - pair[0]?).norm()));
            gains.map(|gain_mps| gain_mps / scene.dt_s).collect::<Vec<f64>>()
        });
        // A track is in many windows of its recording.
        let names: BTreeSet<_> =
            tracks.iter().map(|(scene, track)| (&scene.source.file, &scene.source.case_id, &track.id)).collect();
        ClassFacts {
            class,
            n_tracks: names.len(),
            size_m: median(lengths).zip(median(widths)).map(|(length, width)| [length, width]),
            speeds_mps: [0.05, 0.5, 0.95].map(|share| quantile(&speeds, share).unwrap_or_default()),
            acceleration_mps2: quantile(&sorted(accelerations.collect()), 0.95).unwrap_or_default(),
            slip_deg: median(slips.collect()),
        }
    };
    of_class.into_iter().map(facts).collect()
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

fn median(values: Vec<f64>) -> Option<f64> {
    quantile(&sorted(values), 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn figures_are_those_of_the_scenes() {
        let moving = Drive::straight(0.0, 0.0, 0.0, 10.0);
        let standing = Drive::straight(20.0, 3.5, 0.0, 0.0);
        let scenes = [scene(&[moving, standing])];
        let text = Explanation::of(&scenes, &IngestReport::default()).to_string();
        assert!(text.contains("left out   nothing"), "{text}");
        assert!(text.contains("y from 0.0 to 3.5 m"), "{text}");
        let row = text.lines().find(|line| line.starts_with("vehicle")).unwrap();
        assert!(
            row.contains(" 2 ")
                && row.contains("0.0, ")
                && row.contains(", 10.0 m/s")
                && row.contains(" 0.0 m/s2")
                && row.contains("0.0 deg"),
            "{row}"
        );
        assert!(text.contains("100 % of moving vehicles are within 2 m") && !text.contains("doubt"), "{text}");
        let mut against = scene(&[moving, standing]);
        for track in &mut against.tracks {
            let turned = |state: &State| State { heading_rad: state.heading_rad + 3.0, ..*state };
            let states = track.trajectory.entries().iter().map(|state| state.as_ref().map(turned)).collect();
            track.trajectory = crate::scene::Trajectory::new(states);
        }
        let text = Explanation::of(&[against], &IngestReport::default()).to_string();
        assert!(text.contains("doubt") && text.contains("few vehicles drive along lanes"), "{text}");
    }
}
