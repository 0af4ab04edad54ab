//! Short losses of a tracker: gaps within tracks are counted, and tracks that continue under another id are joined.

use super::raw::{Finding, RawScene};
use super::report::IngestReport;
use crate::geometry::angle_difference;
use crate::scene::{Derivation, State, Track, TrackRole, Trajectory};

/// Longest short gap, seconds.
const MAX_GAP_S: f64 = 1.0;
/// A continuation is this close to where the last motion leads, meters, with this close a speed, m/s, and heading,
/// radians.
const MAX_OFF_M: f64 = 1.0;
const MAX_OFF_MPS: f64 = 3.0;
const MAX_OFF_RAD: f64 = 0.5;
/// Its size differs by less than this, meters.
const MAX_OFF_SIZE_M: f64 = 0.5;

/// Joins tracks that continue others, and counts them and the gaps within tracks. Tracks with a role in their dataset
/// stay as they are, as do those of some datasets.
pub(super) fn mend(raw: &mut RawScene, counts: &mut IngestReport) {
    let max_gap = (MAX_GAP_S / raw.dt_s).round() as usize;
    let keeps_tracks = raw.source.dataset.facts().has_chosen_tracks;
    let starts = (0..raw.tracks.len()).filter(|_| !keeps_tracks).filter_map(|idx| {
        let (start, first) = raw.tracks[idx].trajectory.valid().next()?;
        Some((start, first.position.x, idx))
    });
    let mut starts: Vec<(usize, f64, usize)> = starts.collect();
    // Crowds have thousands of tracks: only those are compared that begin when and where one ends.
    starts.sort_by(|(a, x, _), (b, other_x, _)| a.cmp(b).then(x.total_cmp(other_x)));
    let near = |start: usize, x: f64| {
        let at = |x: f64| starts.partition_point(|(from, at, _)| (*from, *at) < (start, x));
        starts[at(x - MAX_OFF_M)..at((x + MAX_OFF_M).next_up())].iter().map(|(.., idx)| *idx)
    };
    let mut joined: Option<String> = None;
    let mut is_gone = vec![false; raw.tracks.len()];
    let mut idx = 0;
    while idx < raw.tracks.len() {
        let Some((end, last)) = raw.tracks[idx].trajectory.valid().next_back().filter(|_| !is_gone[idx]) else {
            idx += 1;
            continue;
        };
        let reached_x = |start: usize| last.position.x + last.velocity.x * (start - end) as f64 * raw.dt_s;
        let begin = (end + 1..=end + max_gap).flat_map(|start| near(start, reached_x(start)));
        let next = |later: &usize| continues(&raw.tracks[idx], &raw.tracks[*later], raw.dt_s, max_gap);
        let candidates: Vec<usize> = begin.filter(|later| *later != idx && !is_gone[*later]).filter(next).collect();
        // Among several, none is certain.
        let [later] = candidates[..] else {
            idx += 1;
            continue;
        };
        joined.get_or_insert_with(|| format!("track {} is {} again", raw.tracks[later].id, raw.tracks[idx].id));
        let whole = join(&raw.tracks[idx], &raw.tracks[later]);
        raw.tracks[idx] = whole;
        is_gone[later] = true;
    }
    let n_joined = is_gone.iter().filter(|is_gone| **is_gone).count() as u64;
    if n_joined > 0 {
        let places: Vec<usize> = is_gone
            .iter()
            .scan(0, |place, is_gone| Some(std::mem::replace(place, *place + usize::from(!is_gone))))
            .collect();
        raw.heading_gaps.retain(|gap| !is_gone[gap.track_idx]);
        raw.heading_gaps.iter_mut().for_each(|gap| gap.track_idx = places[gap.track_idx]);
        let mut kept = is_gone.iter().map(|is_gone| !is_gone);
        raw.tracks.retain(|_| kept.next().unwrap_or(true));
    }
    if let Some(first) = joined {
        let detail = format!("{}: scene {}: {first}", raw.source.file, raw.id);
        raw.findings.push(Finding { what: "tracks_joined", n: n_joined, detail });
    }
    let n_gaps = raw.tracks.iter().map(|track| n_gaps(&track.trajectory, max_gap)).sum();
    counts.count_assumed("gaps_left_open_within_tracks", n_gaps);
}

fn n_gaps(trajectory: &Trajectory, max_gap: usize) -> u64 {
    let timesteps: Vec<usize> = trajectory.valid().map(|(timestep, _)| timestep).collect();
    timesteps.windows(2).filter(|pair| (2..=max_gap).contains(&(pair[1] - pair[0]))).count() as u64
}

fn continues(track: &Track, later: &Track, dt_s: f64, max_gap: usize) -> bool {
    let ends = track.trajectory.valid().next_back().zip(later.trajectory.valid().next());
    let Some(((end, last), (start, first))) = ends else { return false };
    if start <= end || start - end > max_gap || track.class != later.class {
        return false;
    }
    let gap_s = (start - end) as f64 * dt_s;
    let is_near = (last.position + last.velocity * gap_s).distance(first.position) <= MAX_OFF_M;
    let is_as_fast = (last.velocity.norm() - first.velocity.norm()).abs() <= MAX_OFF_MPS;
    let turns = |a: &State, b: &State| angle_difference(a.heading_rad, b.heading_rad).abs() <= MAX_OFF_RAD;
    let is_as_large = track.extent.zip(later.extent).is_none_or(|(a, b)| {
        f64::max((a.length_m - b.length_m).abs(), (a.width_m - b.width_m).abs()) <= MAX_OFF_SIZE_M
    });
    let is_free = [track, later].iter().all(|track| matches!(track.role, TrackRole::Context | TrackRole::Parked));
    is_free && is_near && is_as_fast && turns(last, first) && is_as_large
}

/// The first track, extended by the states of the second.
fn join(track: &Track, later: &Track) -> Track {
    let [own, more] = [track, later].map(|track| track.trajectory.entries());
    let trajectory = Trajectory::new(own.iter().zip(more).map(|(own, more)| own.or(*more)).collect());
    let derivations = [track, later].map(|track| track.trajectory.derivation());
    let held = |timestep: usize| {
        let of = usize::from(own[timestep].is_none());
        derivations[of].is_some_and(|derivation| derivation.held_headings[timestep])
    };
    let derived = Derivation {
        held_headings: (0..own.len()).map(held).collect(),
        recorded: derivations.iter().flatten().flat_map(|derivation| derivation.recorded.clone()).collect(),
    };
    let is_derived = derivations.iter().any(Option::is_some);
    let trajectory = if is_derived { trajectory.derived(derived) } else { trajectory };
    Track { extent: track.extent.or(later.extent), trajectory, ..track.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::test_data;
    use crate::scene::testing::{Drive, scene, without_states};

    fn mended(change: impl Fn(&mut crate::scene::Scene)) -> [Vec<String>; 2] {
        // The second continues where the first would be after 0.7 s; the third is far away.
        let drives = [0.0, 0.0, 50.0].map(|x| Drive::straight(x, 1.0, 0.2, 10.0));
        let scene = without_states(scene(&drives), 0, |timestep| timestep > 4);
        let mut scene = without_states(without_states(scene, 1, |timestep| timestep < 8), 2, |t| t == 5 || t == 6);
        change(&mut scene);
        let mut raw = test_data::raw(scene);
        let mut counts = IngestReport::default();
        mend(&mut raw, &mut counts);
        let tracks = raw.tracks.iter().map(|track| format!("{}: {}", track.id, track.trajectory.n_valid()));
        let findings = raw.findings.iter().map(|finding| format!("{}: {}", finding.what, finding.n));
        let gaps = counts.assumed.iter().map(|(what, n)| format!("{what}: {n}"));
        [tracks.collect(), findings.chain(gaps).collect()]
    }

    #[test]
    fn a_track_that_goes_on_under_another_id_is_one() {
        let [tracks, findings] = mended(|_| {});
        assert_eq!(tracks, ["1: 9", "3: 10"]);
        assert_eq!(findings, ["tracks_joined: 1", "gaps_left_open_within_tracks: 2"]);
        assert_eq!(mended(|scene| scene.tracks.swap(0, 1))[0], ["1: 9", "3: 10"]);
        let of_benchmark = mended(|scene| scene.source.dataset = crate::scene::Dataset::Argoverse1);
        assert_eq!(of_benchmark[0].len(), 3, "{of_benchmark:?}");
    }

    #[test]
    fn crowds_take_no_longer_than_their_number() {
        let [tracks, _] = mended(|scene| {
            let standing = scene.tracks[2].clone();
            scene.tracks.extend((0..50_000).map(|_| standing.clone()));
        });
        assert_eq!(tracks.len(), 50_002);
    }

    #[test]
    fn others_stay_apart() {
        let far = |scene: &mut crate::scene::Scene| scene.tracks[1] = scene.tracks[2].clone();
        let scored = |scene: &mut crate::scene::Scene| scene.tracks[1].role = TrackRole::Scored;
        let larger = |scene: &mut crate::scene::Scene| {
            scene.tracks[1].extent =
                scene.tracks[1].extent.map(|extent| crate::scene::Extent { length_m: 9.0, ..extent });
        };
        for change in [&far as &dyn Fn(&mut crate::scene::Scene), &scored, &larger] {
            assert_eq!(mended(change)[0].len(), 3);
        }
    }
}
