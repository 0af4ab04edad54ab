//! Submissions to INTERACTION's multi-agent benchmark: one CSV a place, one row a track and frame, six modes.

use super::predicted;
use crate::metrics::Modes;
use crate::scene::{AgentClass, Benchmark, Scene, State, TrackRole};
use crate::store::corpus_layout::encoded;
use crate::store::{AtomicFile, Result};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Modes of a submission.
const N_MODES: usize = 6;

/// Writes `<place>_sub.csv` for each place, encoded as in folder names of a corpus, into a folder:
/// `case_id,track_id,frame_id,timestamp_ms,track_to_predict, interesting_agent,x1,y1,psi_rad1,…,x6,y6,psi_rad6`, in the
/// recording's frame, meters and radians, the likeliest mode first.
///
/// The predicted tracks are those that the recording marks. If it marks none (train and val), they are the ego and the
/// vehicles that are recorded throughout, with the ego as the interesting agent. With fewer than six modes, the last
/// one is repeated. Only cases of v1.2 can be submitted: windows of v1.1 recordings have no case ids.
#[derive(Debug)]
pub struct InteractionPredictions {
    dir: PathBuf,
    files: BTreeMap<String, AtomicFile>,
}

impl InteractionPredictions {
    /// Begins to write into `dir`, which must exist.
    pub fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), files: BTreeMap::new() }
    }

    /// Adds the modes of a case. Returns the number of required tracks that were left out because a mode lacks a state;
    /// all of them if the scene is not a case of v1.2.
    pub fn add(&mut self, recorded: &Scene, modes: &Modes) -> Result<usize> {
        let targets = targets(recorded);
        let source = &recorded.source;
        let first_frame: Option<i64> = source.first_frame.parse().ok();
        let Some(first_frame) = first_frame.filter(|_| {
            source.dataset.facts().benchmark == Some(Benchmark::InteractionJoint) && source.version == "v1.2"
        }) else {
            return Ok(targets.len());
        };
        let mut n_left_out = 0;
        let mut text = String::new();
        for agent_idx in targets {
            let Some(modes) = predicted(recorded, modes, agent_idx) else {
                n_left_out += 1;
                continue;
            };
            let is_ego = u8::from(agent_idx == recorded.ego_idx);
            let track_id = &recorded.tracks[agent_idx].id;
            let paths: Vec<&Vec<State>> = (0..N_MODES).map(|k| &modes[k.min(modes.len() - 1)]).collect();
            let frames = (first_frame + recorded.n_history as i64..).take(paths[0].len());
            for (step, frame) in frames.enumerate() {
                text.push_str(&format!("{},{track_id},{frame},{},1,{is_ego}", source.case_id, 100 * frame));
                for path in &paths {
                    let State { position, heading_rad, .. } = path[step];
                    text.push_str(&format!(",{:.4},{:.4},{heading_rad:.4}", position.x, position.y));
                }
                text.push('\n');
            }
        }
        if !text.is_empty() {
            self.file(&source.place)?.write_all(text.as_bytes())?;
        }
        Ok(n_left_out)
    }

    /// Gives the files their names and returns their number.
    pub fn finish(self) -> Result<usize> {
        let n_files = self.files.len();
        for file in self.files.into_values() {
            file.commit()?;
        }
        Ok(n_files)
    }

    fn file(&mut self, place: &str) -> Result<&mut AtomicFile> {
        if !self.files.contains_key(place) {
            let mut file = AtomicFile::create(&self.dir.join(format!("{}_sub.csv", encoded(place))))?;
            let modes: String = (1..=N_MODES).map(|k| format!(",x{k},y{k},psi_rad{k}")).collect();
            writeln!(file, "case_id,track_id,frame_id,timestamp_ms,track_to_predict,interesting_agent{modes}")?;
            self.files.insert(place.to_owned(), file);
        }
        self.files.get_mut(place).ok_or_else(|| crate::store::Error::invalid(place, "has no file".to_owned()))
    }
}

fn targets(recorded: &Scene) -> Vec<usize> {
    let is_marked = |agent: &usize| matches!(recorded.tracks[*agent].role, TrackRole::Focal | TrackRole::Scored);
    let marked: Vec<usize> = (0..recorded.tracks.len()).filter(is_marked).collect();
    if !marked.is_empty() {
        return marked;
    }
    let is_whole = |agent: &usize| {
        let track = &recorded.tracks[*agent];
        track.class == AgentClass::Vehicle && track.trajectory.n_valid() == recorded.n_timesteps
    };
    (0..recorded.tracks.len()).filter(|agent| *agent == recorded.ego_idx || is_whole(agent)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Transform2, Vec2};
    use crate::scene::testing::{self, Drive};

    fn written(recorded: &Scene, modes: &Modes) -> (usize, Vec<String>) {
        let dir = tempfile::tempdir().unwrap();
        let mut predictions = InteractionPredictions::new(dir.path());
        let n_left_out = predictions.add(recorded, modes).unwrap();
        predictions.finish().unwrap();
        let text = fs_err::read_to_string(dir.path().join("Test_sub.csv")).unwrap_or_default();
        (n_left_out, text.lines().map(str::to_owned).collect())
    }

    #[test]
    fn rows_are_those_of_the_recordings_frame() {
        // Four observed of twelve frames, from frame 1 on: the future is frames 5 to 12. The scene's x axis points
        // north in the recording, and its origin is at (1000, 2000).
        let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(-20.0, 3.0, 0.0, 10.0)];
        let mut recorded = testing::scene(&drives);
        recorded.world_from_scene = Transform2::from_pose(Vec2::new(1000.0, 2000.0), std::f64::consts::FRAC_PI_2);
        let other = testing::scene(&[drives[0], Drive::straight(-20.0, 4.0, 0.0, 10.0)]);
        let modes = Modes { samples: vec![recorded.clone(), other], probabilities: vec![0.75, 0.25] };
        let (n_left_out, lines) = written(&recorded, &modes);
        assert_eq!((n_left_out, lines.len()), (0, 1 + 2 * 8));
        assert!(lines[0].starts_with(
            "case_id,track_id,frame_id,timestamp_ms,track_to_predict,interesting_agent,x1,y1,psi_rad1,x2"
        ));
        assert!(lines[0].ends_with(",x6,y6,psi_rad6"));
        // After 0.4 s the ego is 4 m north of the origin, in all modes.
        assert_eq!(lines[1], format!("1,1,5,500,1,1{}", ",1000.0000,2004.0000,1.5708".repeat(6)));
        // The other one is 16 m behind and 3 m to the left, which is west; in the second mode 4 m, and the second is
        // repeated.
        let second = ",996.0000,1984.0000,1.5708".repeat(5);
        assert_eq!(lines[9], format!("1,2,5,500,1,0,997.0000,1984.0000,1.5708{second}"));
        assert!(lines[16].starts_with("1,2,12,1200,1,0,"));
    }

    #[test]
    fn marks_decide_and_what_cannot_be_submitted_is_counted() {
        let mut recorded = testing::scene(&[
            Drive::straight(0.0, 0.0, 0.0, 10.0),
            Drive::straight(0.0, 9.0, 0.0, 10.0),
            Drive::straight(0.0, 18.0, 0.0, 10.0),
        ]);
        recorded.tracks[0].role = TrackRole::Focal;
        recorded.tracks[2].role = TrackRole::Scored;
        let lacking = testing::without_states(recorded.clone(), 2, |timestep| timestep == 8);
        let modes = |scene: &Scene| Modes { samples: vec![scene.clone()], probabilities: vec![1.0] };
        assert_eq!(written(&recorded, &modes(&recorded)).1.len(), 1 + 2 * 8);
        let (n_left_out, lines) = written(&recorded, &modes(&lacking));
        assert_eq!((n_left_out, lines.len()), (1, 1 + 8));
        recorded.source.version = "v1.1".to_owned();
        assert_eq!(written(&recorded, &modes(&recorded)), (2, Vec::new()));
    }
}
