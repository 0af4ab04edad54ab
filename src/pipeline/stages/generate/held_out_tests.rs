//! Is anything sampled that was trained on, whatever the recordings are called and wherever they lie?

use super::*;
use crate::ingest::{IngestConfig, ingest};
use crate::pipeline::config::parse;
use crate::pipeline::stages::generation;
use crate::pipeline::stages::train::scenes_learned_from;
use crate::pipeline::stages::training_scenes::OpenedScenes;
use crate::progress::Silent;
use crate::scene::{Dataset, Scene, Split};
use crate::store::SceneWriter;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const RECORDINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/recordings");
const PIPELINE: &str = "[train.denoiser]\npreset = 'tiny'\n[train.baseline]\npreset = 'tiny'\n\
                        [[generate.sweeps]]\nname = 'futures'\nn_scenes = 1000\n";

/// A CommonRoad file with two cars: `n` timesteps of a longer recording, the one of this `number`, from `first` on.
fn commonroad(id: &str, number: usize, [first, n]: [usize; 2]) -> (String, Vec<u8>) {
    let lane = "<lanelet id=\"1\"><leftBound><point><x>-50</x><y>3</y></point><point><x>900</x><y>3</y></point>\
                </leftBound><rightBound><point><x>-50</x><y>-3</y></point><point><x>900</x><y>-3</y></point>\
                </rightBound></lanelet>";
    let mut text = format!("<commonRoad benchmarkID=\"{id}\" commonRoadVersion=\"2020a\" timeStepSize=\"0.1\">{lane}");
    for (car, speed) in [(7, 1.0), (8, 1.13)] {
        let state = |name: &str, time: usize| {
            // The speed varies, so that no moment is like another.
            let t = (first + time) as f64;
            let x = speed * t + 5.0 * (0.05 * speed * t + number as f64).sin();
            format!(
                "<{name}><position><point><x>{x:.4}</x><y>0</y></point></position><orientation><exact>0</exact>\
                 </orientation><time><exact>{time}</exact></time><velocity><exact>10</exact></velocity></{name}>"
            )
        };
        write!(
            text,
            "<dynamicObstacle id=\"{car}\"><type>car</type><shape><rectangle><length>4</length><width>2</width>\
             </rectangle></shape>{}<trajectory>{}</trajectory></dynamicObstacle>",
            state("initialState", 0),
            (1..n).map(|time| state("state", time)).collect::<String>()
        )
        .unwrap();
    }
    (format!("{id}.xml"), (text + "</commonRoad>").into_bytes())
}

/// Files of a fixture below `from`, as they lie there below `to`.
fn fixture(from: &str, to: &str) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    let mut folders = vec![PathBuf::from(RECORDINGS).join(from)];
    while let Some(folder) = folders.pop() {
        for entry in fs_err::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let within = path.strip_prefix(Path::new(RECORDINGS).join(from)).unwrap();
            files.push((format!("{to}/{}", within.display()), fs_err::read(&path).unwrap()));
        }
    }
    files
}

/// The scenes that are sampled after training, and those that were trained on.
fn sampled_and_trained(config: &IngestConfig, pipeline: &str) -> Result<[Vec<Scene>; 2]> {
    let root = tempfile::tempdir().unwrap();
    let layout = Layout { denoiser: "pipelines/models/geometric.safetensors".into(), ..Layout::below(root.path()) };
    let (mut writer, _) = SceneWriter::resume(&layout.scenes).unwrap();
    let report = ingest(config, None, &Silent, &mut |batch| {
        Ok(writer.write_batch(&batch.scenes, &batch.maps, batch.units_done, &json!({}))?)
    });
    writer.finish(&json!(report.unwrap())).unwrap();
    let store = SceneStore::open(&layout.scenes).unwrap();
    let load = |idx: usize| store.scene(idx).unwrap();
    let pipeline = parse(None, pipeline, &[]).unwrap();

    let mut trained = std::collections::BTreeSet::new();
    for choice in scenes_learned_from(&pipeline.train) {
        let opened = OpenedScenes::open(choice, &layout.scenes, &Silent)?;
        let data = opened.training_data(None, true)?;
        trained.extend(data.sources.into_iter().flat_map(|source| source.train));
    }
    let stage = generation(&pipeline, &layout).unwrap();
    let sampled: Vec<usize> = stage.with_ready(&Compute::cpu(), None, |ready| {
        let cells = ready.plan(&Silent)?.shards.into_iter().flat_map(|shard| shard.cells);
        Ok(cells.map(|cell| cell.scene_idx).collect())
    })?;
    let sampled = sampled.into_iter().map(|idx| stage.scene_of(&store, idx).unwrap()).collect();
    Ok([sampled, trained.into_iter().map(load).collect()])
}

#[test]
fn nothing_that_is_sampled_was_trained_on() {
    let scenario = |i: usize| format!("USA_Some-{i}_1_T-1");
    let files = |n: usize| (0..n).map(|i| commonroad(&scenario(i), i, [0, 60])).collect::<Vec<_>>();
    let flat = [fixture("argoverse1/train/data", "all"), fixture("argoverse1/map_files", "maps")].concat();
    let of_a_minute = (0..4).map(|i| commonroad(&scenario(i), 0, [150 * i, 300])).collect();
    let copies = (0..6).map(|i| commonroad(&scenario(i), i / 2, [0, 60])).collect();
    type Files = Vec<(String, Vec<u8>)>;
    let cases: [(&str, Dataset, Files); 8] = [
        ("a flat folder", Dataset::Argoverse1, flat),
        ("train and val", Dataset::Argoverse1, fixture("argoverse1", "av1")),
        ("a recording that the ingest divides", Dataset::Interaction, fixture("interaction_v1_1", "v1")),
        ("many files", Dataset::CommonRoad, files(12)),
        ("two files", Dataset::CommonRoad, files(2)),
        ("one long file", Dataset::CommonRoad, vec![commonroad(&scenario(1), 0, [0, 500])]),
        ("files of the same minute", Dataset::CommonRoad, of_a_minute),
        ("copies under other ids", Dataset::CommonRoad, copies),
    ];
    for (what, dataset, files) in cases {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            let path = folder.path().join(name);
            fs_err::create_dir_all(path.parent().unwrap()).unwrap();
            fs_err::write(path, bytes).unwrap();
        }
        let config = IngestConfig { window_stride: 13, ..IngestConfig::new(dataset, vec![folder.path().to_owned()]) };
        let [sampled, trained] =
            sampled_and_trained(&config, PIPELINE).unwrap_or_else(|error| panic!("{what}: {error:?}"));
        assert!(!sampled.is_empty() && !trained.is_empty(), "{what}");
        for (a, b) in sampled.iter().flat_map(|a| trained.iter().map(move |b| (a, b))) {
            let is_same_file = (&a.source.file, &a.source.case_id) == (&b.source.file, &b.source.case_id);
            let frame = |scene: &Scene| scene.source.first_frame.parse::<i64>().unwrap_or(0);
            let apart = (frame(a) - frame(b)).unsigned_abs() as usize;
            assert!(!is_same_file || apart >= a.n_timesteps, "{what}: {} and {}", a.id, b.id);
            assert!(!shares_a_moment(a, b), "{what}: {} and {}", a.id, b.id);
            assert_eq!(a.source.split, Split::Val, "{what}");
        }
    }
}

/// Whether all agents of a timestep of one scene are at the same places at one of the other.
fn shares_a_moment(a: &Scene, b: &Scene) -> bool {
    let places = |scene: &Scene, timestep: usize| -> Vec<(i64, i64)> {
        let at = |position| scene.world_from_scene.point(position);
        let places = scene.tracks.iter().filter_map(|track| Some(at(track.trajectory.get(timestep)?.position)));
        let mut places: Vec<_> =
            places.map(|at| ((at.x * 100.0).round() as i64, (at.y * 100.0).round() as i64)).collect();
        places.sort_unstable();
        places
    };
    let moments = |scene: &Scene| (0..scene.n_timesteps).map(|timestep| places(scene, timestep)).collect::<Vec<_>>();
    let of_b = moments(b);
    moments(a).iter().any(|moment| moment.len() > 1 && of_b.contains(moment))
}

#[test]
fn what_cannot_be_held_out_is_sampled_only_if_splits_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (name, bytes) = commonroad("USA_Some-1_1_T-1", 0, [0, 45]);
    fs_err::write(folder.path().join(name), bytes).unwrap();
    let config = IngestConfig::new(Dataset::CommonRoad, vec![folder.path().to_owned()]);
    let refused = sampled_and_trained(&config, PIPELINE).unwrap_err().error.to_string();
    assert!(refused.contains("nothing is held out") && refused.contains("generate.splits"), "{refused}");
    let asked = PIPELINE.replace("[[", "[generate]\nsplits = ['unsplit']\n[[");
    let [sampled, trained] = sampled_and_trained(&config, &asked).unwrap();
    assert_eq!((sampled.len(), trained.len(), sampled[0].source.split), (1, 1, Split::Unsplit));
    // A run that learns from nothing samples everything.
    let bundled = PIPELINE.replace("preset = 'tiny'", "checkpoint = 'elsewhere'");
    let [sampled, trained] = sampled_and_trained(&config, &bundled).unwrap();
    assert_eq!((sampled.len(), trained.len(), sampled[0].source.split), (1, 0, Split::Unsplit));
}
