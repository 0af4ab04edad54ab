//! The driver end to end: order, resuming, limits, threads, and real recordings if available.

use super::*;
use crate::ingest::argoverse1::csv_text;
use crate::ingest::argoverse2::scenario_bytes;
use crate::ingest::{MapsConfig, test_data};
use crate::progress::{Heard, Silent};
use crate::scene::Dataset;
use flate2::write::GzEncoder;
use std::io::Write;
use std::path::Path;

const MAP: &str = r#"<ArgoverseVectorMap><node id="0" x="900" y="2000"/><node id="1" x="1200" y="2000"/>
    <way lane_id="5"><nd ref="0"/><nd ref="1"/></way></ArgoverseVectorMap>"#;

/// A folder with `n_scenes` recordings, every tenth of which has no AGENT, and a map of their city.
fn folder(n_scenes: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let data = folder.path().join("train/data");
    fs_err::create_dir_all(&data).expect("writable");
    fs_err::write(folder.path().join("pruned_argoverse_PIT_10314_vector_map.xml"), MAP).expect("writable");
    for i in 0..n_scenes {
        let text = csv_text(50).replace("parked", &format!("parked-{i}"));
        let text = if i % 10 == 9 { text.replace("AGENT", "OTHERS") } else { text };
        fs_err::write(data.join(format!("{i:04}.csv")), text).expect("writable");
    }
    folder
}

fn config(path: &Path) -> IngestConfig {
    IngestConfig::new(Dataset::Argoverse1, vec![path.to_owned()])
}

fn run(config: &IngestConfig, done: Option<Done>) -> Result<(Vec<IngestBatch>, IngestReport), Error> {
    let mut batches = Vec::new();
    let report = ingest(config, done, &Silent, &mut |batch| {
        batches.push(batch);
        Ok(())
    })?;
    Ok((batches, report))
}

fn done(batches: &[IngestBatch]) -> Option<Done> {
    let mut done = Done { scenes: scenes(batches).iter().map(Scene::identity).collect(), ..Done::default() };
    batches.iter().for_each(|batch| done.report.merge(&batch.report));
    Some(done)
}

/// Packs a file of a folder as another one of it.
fn pack(folder: &Path, from: &str, to: &str) {
    let mut packed = GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&fs_err::read(folder.join(from)).expect("there")).expect("memory");
    let to = folder.join(to);
    fs_err::create_dir_all(to.parent().expect("a folder")).expect("writable");
    fs_err::write(to, packed.finish().expect("memory")).expect("writable");
}

fn scenes(batches: &[IngestBatch]) -> Vec<Scene> {
    batches.iter().flat_map(|batch| batch.scenes.clone()).collect()
}

#[test]
fn scenes_come_in_order_with_their_map_once() {
    let folder = folder(130);
    let (batches, report) = run(&config(folder.path()), None).expect("whole");
    let cases: Vec<String> = scenes(&batches).into_iter().map(|scene| scene.source.case_id).collect();
    let expected: Vec<String> = (0..130).filter(|i| i % 10 != 9).map(|i| format!("{i:04}")).collect();
    assert_eq!(cases, expected);
    let maps: Vec<usize> = batches.iter().map(|batch| batch.maps.len()).collect();
    assert_eq!(maps, [1, 0, 0]);
    assert_eq!(batches.iter().map(|batch| batch.units_done).collect::<Vec<_>>(), [Some(64), Some(128), Some(130)]);
    assert_eq!((report.n_units, report.n_scenes, report.n_agents), (130, 117, 351));
    assert_eq!(report.scenes_by["train/PIT"], 117);
    assert_eq!(report.rejects["no_agent_track"].count, 13);
    assert!(report.rejects["no_agent_track"].examples[0].starts_with("train/data/0009.csv: "));
    assert_eq!(report.assumed["headings_from_lanes"], 117, "the parked vehicle stands 3.5 m from the lane");
    let mut sum = IngestReport::default();
    batches.iter().for_each(|batch| sum.merge(&batch.report));
    assert_eq!(sum, report);
}

#[test]
fn resuming_continues_with_the_same_batches() {
    let folder = folder(130);
    // The same scene once more, far behind.
    pack(folder.path(), "train/data/0005.csv", "train/more/0005.csv.gz");
    for limit in [None, Some(100)] {
        let config = IngestConfig { limit, ..config(folder.path()) };
        let (batches, report) = run(&config, None).expect("whole");
        let (resumed, resumed_report) = run(&config, done(&batches[..1])).expect("whole");
        assert_eq!(scenes(&resumed), scenes(&batches[1..]));
        assert_eq!(resumed_report, report);
        assert_eq!(report.rejects.get("scene_repeated").map(|found| found.count), limit.is_none().then_some(1));
        let (nothing, _) = run(&config, done(&batches)).expect("all was done");
        assert!(nothing.iter().all(|batch| batch.scenes.is_empty()));
    }
}

#[test]
fn the_windows_of_a_recording_come_a_few_at_a_time() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let text = |n_frames: u32| {
        let rows = (1..=n_frames).map(|f| format!("7,{f},{f}00,car,{f},2,10,0,0,4.5,1.8\n"));
        let header = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";
        std::iter::once(header.to_owned()).chain(rows).collect::<String>()
    };
    let place = folder.path().join("train/SIM_A");
    fs_err::create_dir_all(&place).expect("writable");
    for (number, n_frames) in [(0, 189), (1, 39), (2, 49)] {
        fs_err::write(place.join(format!("vehicle_tracks_00{number}.csv")), text(n_frames)).expect("writable");
    }
    let config = IngestConfig {
        maps: MapsConfig::None,
        window_stride: 1,
        ..IngestConfig::new(Dataset::Interaction, vec![folder.path().to_owned()])
    };
    let (batches, report) = run(&config, None).expect("whole");
    // 150 windows of 40 frames, a recording that is too short, 10 windows.
    let sizes: Vec<_> = batches.iter().map(|batch| (batch.scenes.len(), batch.units_done)).collect();
    assert_eq!(sizes, [(64, None), (64, None), (32, Some(3))]);
    assert_eq!((report.n_units, report.n_scenes, report.n_rejects()), (3, 160, 1));
    let first_frames: Vec<String> = scenes(&batches).into_iter().map(|scene| scene.source.first_frame).collect();
    let expected: Vec<String> = (1..=150).chain(1..=10).map(|frame: u32| frame.to_string()).collect();
    assert_eq!(first_frames, expected);
    // A limit within a recording is reported.
    let (batches, report) = run(&IngestConfig { limit: Some(70), ..config }, None).expect("whole");
    assert_eq!(batches.iter().map(|batch| batch.units_done).collect::<Vec<_>>(), [None, Some(1)]);
    assert_eq!((report.n_units, report.n_scenes), (1, 70));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let folder = folder(70);
    let on_threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        pool.install(|| run(&config(folder.path()), None)).map(|(batches, report)| (scenes(&batches), report))
    };
    assert_eq!(on_threads(1).expect("whole"), on_threads(3).expect("whole"));
}

#[test]
fn the_limit_counts_scenes() {
    let folder = folder(130);
    let (all, _) = run(&config(folder.path()), None).expect("whole");
    for limit in [1, 9, 58, 59, 500] {
        let (batches, report) =
            run(&IngestConfig { limit: Some(limit), ..config(folder.path()) }, None).expect("whole");
        assert_eq!(report.n_scenes, limit.min(117));
        assert_eq!(scenes(&batches), scenes(&all)[..report.n_scenes as usize]);
    }
}

#[test]
fn copies_of_recordings_are_rejected() {
    let folder = folder(3);
    let file = |name: &str| folder.path().join("train/data").join(name);
    fs_err::copy(file("0001.csv"), file("0001 (1).csv")).expect("writable");
    let (_, report) = run(&config(folder.path()), None).expect("the others are whole");
    assert_eq!((report.n_scenes, report.n_units), (3, 4));
    assert!(report.rejects["recording_repeated"].examples[0].starts_with("train/data/0001 (1).csv: "));

    // Equal content is one recording, whatever it is called, wherever it lies and however its lines end; others of the
    // same size are none.
    let text = fs_err::read_to_string(file("0001.csv")).expect("text");
    fs_err::remove_file(file("0001 (1).csv")).expect("writable");
    let aside = folder.path().join("val/data/0001_copy.csv");
    fs_err::create_dir_all(aside.parent().expect("a folder")).expect("writable");
    let of_windows = text.replace('\n', "\r\n") + "\r\n\r\n";
    for (path, text) in [(&file("0001 - Kopie.csv"), &text), (&file("0001_old.csv"), &of_windows), (&aside, &text)] {
        fs_err::write(path, text).expect("writable");
    }
    fs_err::write(file("0009.csv"), text.replacen("2003.5", "2003.6", 1)).expect("writable");
    let (_, report) = run(&config(folder.path()), None).expect("the others are whole");
    let repeated = &report.rejects["recording_repeated"];
    assert_eq!((repeated.count, report.n_units), (3, 7), "{report:?}");
    for (told, name) in repeated.examples.iter().zip(["0001 - Kopie.csv", "0001_old.csv"]) {
        assert_eq!(*told, format!("train/data/{name}: has the same content as train/data/0001.csv"));
    }
    // Packed, its bytes are others, and its scene is the same.
    pack(folder.path(), "train/data/0001.csv", "train/data/0001.csv.gz");
    let (_, report) = run(&config(folder.path()), None).expect("the others are whole");
    assert_eq!((report.rejects["scene_repeated"].count, report.n_scenes), (1, 4), "{report:?}");
    let told = "train/data/0001.csv: scene argoverse1/train/PIT/0001 was read before; the first stays";
    assert_eq!(report.rejects["scene_repeated"].examples, [told]);
}

#[test]
fn what_is_not_read_is_counted_once() {
    let folder = folder(70);
    let write = |name: &str, text: &str| fs_err::write(folder.path().join(name), text).expect("writable");
    write("train/data/0001.7z", "of another kind");
    write("train/data/broken.zip", "of a kind that is read");
    let broken_lane = r#"<way lane_id="6"><nd ref="9"/></way></ArgoverseVectorMap>"#;
    write("pruned_argoverse_PIT_10314_vector_map.xml", &MAP.replace("</ArgoverseVectorMap>", broken_lane));
    let config = config(folder.path());
    let (batches, report) = run(&config, None).expect("the others are whole");
    assert_eq!((report.n_units, report.n_scenes), (72, 63));
    let archives = &report.rejects["archive_passed_over"];
    assert_eq!(archives.count, 2);
    assert!(archives.examples[0].contains("0001.7z: it is within another archive, or of a kind that is not read"));
    assert!(archives.examples[1].contains("broken.zip: invalid Zip archive"), "{archives:?}");
    let lanes = &report.warnings["broken_lanes"];
    assert_eq!(lanes.count, 1);
    assert!(lanes.examples[0].ends_with("vector_map.xml: way 6: refers to missing node 9"), "{lanes:?}");
    assert_eq!(run(&config, done(&batches[..1])).expect("whole").1, report);
    // Archives that are only among the maps are not recordings.
    let maps = tempfile::tempdir().expect("a temporary folder");
    fs_err::write(maps.path().join("more.rar"), "x").expect("writable");
    let map_inputs = vec![folder.path().to_owned(), maps.path().to_owned()];
    let (_, report) = run(&IngestConfig { map_inputs, ..config }, None).expect("the others are whole");
    assert_eq!((report.rejects["archive_passed_over"].count, report.warnings["archives_passed_over"].count), (2, 3));
}

#[test]
fn missing_maps_are_errors_that_say_what_to_do() {
    let folder = folder(3);
    let message = |config: &IngestConfig| run(config, None).expect_err("no map").to_string();
    let map = folder.path().join("pruned_argoverse_PIT_10314_vector_map.xml");
    let other = folder.path().join("pruned_argoverse_MIA_10316_vector_map.xml");
    fs_err::rename(&map, &other).expect("writable");
    let text = message(&config(folder.path()));
    assert!(text.contains("no map for argoverse1/PIT") && text.contains("argoverse1/MIA"), "{text}");
    fs_err::remove_file(other).expect("writable");
    assert!(message(&config(folder.path())).contains("ingest.maps = \"none\""));
    fs_err::write(folder.path().join("maps.tar.xz"), "x").expect("writable");
    let text = message(&config(folder.path()));
    assert!(text.contains(", where maps.tar.xz cannot be read; unpack it; add the map files"), "{text}");
    let without = IngestConfig { maps: MapsConfig::None, ..config(folder.path()) };
    let (batches, report) = run(&without, None).expect("maps are not needed");
    assert!(batches[0].maps.is_empty() && scenes(&batches)[0].map_id.is_none());
    assert_eq!(report.assumed["headings_unknown"], 3);
}

#[test]
fn no_scenes_is_an_error_that_says_what_was_seen() {
    let folder = folder(3);
    fs_err::write(folder.path().join("train/data/notes.txt"), "hello").expect("writable");
    let message = |config: &IngestConfig| run(config, None).expect_err("no scenes").to_string();
    let text = message(&IngestConfig { places: vec!["MIA".to_owned()], ..config(folder.path()) });
    assert_eq!(text, "ingest.places: names MIA, of which there is nothing; there are recordings or maps of PIT");
    for i in 0..3 {
        fs_err::write(folder.path().join(format!("train/data/{i:04}.csv")), "a;b\n1;2\n").expect("writable");
    }
    let text = message(&config(folder.path()));
    assert!(text.contains("3 rejected as bad_header (first: train/data/0000.csv:1: no column"), "{text}");
    assert!(text.contains("3 files named like argoverse1 recordings") && text.contains("3 units read"), "{text}");
    let text = message(&IngestConfig { splits: vec![crate::scene::Split::Val], ..config(folder.path()) });
    assert!(text.contains("0 files named like argoverse1 recordings of the chosen splits, `*.csv`, and "), "{text}");
}

#[test]
fn places_that_are_not_there_are_named_with_those_that_are() {
    let recordings = vec!["tests/fixtures/recordings/interaction_v1_1".into()];
    let at = |places: &[&str], maps: MapsConfig| IngestConfig {
        places: places.iter().map(|place| (*place).to_owned()).collect(),
        maps,
        ..IngestConfig::new(Dataset::Interaction, recordings.clone())
    };
    for maps in [MapsConfig::Required, MapsConfig::None] {
        let text = run(&at(&["Nowhere", "FIX_intersection"], maps), None).expect_err("none is there").to_string();
        let expected = "ingest.places: names Nowhere, FIX_intersection, of which there is nothing; there are \
                        recordings or maps of FIX_Intersection";
        assert_eq!(text, expected, "{maps:?}");
    }
    let config = at(&["Nowhere", "FIX_Intersection"], MapsConfig::None);
    let told = Heard::default();
    assert!(ingest(&config, None, &told, &mut |_| Ok(())).expect("one is there").n_scenes > 0);
    assert_eq!(told.take(), ["ingest.places names Nowhere, of which there is nothing"]);
}

#[test]
fn places_that_name_no_folder_are_rejected() {
    let folder = folder(2);
    let text = csv_text(50).replace("PIT", &"long ".repeat(40));
    fs_err::write(folder.path().join("train/data/0001.csv"), text).expect("writable");
    let without = IngestConfig { maps: MapsConfig::None, ..config(folder.path()) };
    let (_, report) = run(&without, None).expect("the other is whole");
    let expected = "train/data/0001.csv: its place has 199 bytes, expected a name of at most 80";
    assert_eq!(report.rejects["bad_place"].examples, [expected]);
    for (place, id, reason, what) in [("a\u{1b}b", "1", "bad_place", "place"), ("b", "1\u{1b}", "bad_id", "id")] {
        let detail = format!("its {what} has the control character \\u{{1b}}, expected a name");
        assert_eq!(flaw_of(place, id), Some((reason, detail)));
    }
    assert_eq!(flaw_of(&"a".repeat(240), "1"), None);
}

#[test]
fn faults_of_the_whole_input_end_the_ingest() {
    let folder = folder(3);
    assert!(matches!(run(&config(&folder.path().join("nowhere")), None), Err(Error::Io(_))));
    let error =
        ingest(&config(folder.path()), None, &Silent, &mut |_| Err("disk full".into())).expect_err("sink fails");
    assert!(matches!(error, Error::Sink(source) if source.to_string() == "disk full"));
    let archive = folder.path().join("all.tar.gz");
    let mut tar = tar::Builder::new(GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    tar.append_dir_all("train", folder.path().join("train")).expect("readable");
    let bytes = tar.into_inner().and_then(GzEncoder::finish).expect("memory");
    fs_err::File::create(&archive).and_then(|mut file| file.write_all(&bytes[..bytes.len() / 2])).expect("writable");
    let cut = IngestConfig { maps: MapsConfig::None, ..config(&archive) };
    let text = run(&cut, None).expect_err("truncated").to_string();
    assert!(text.contains("all.tar.gz"), "{text}");
}

#[test]
fn argoverse_2_scenarios_need_their_maps() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let lane = r#"{"id": 1, "lane_type": "VEHICLE", "is_intersection": false,
        "left_lane_boundary": [{"x": 0, "y": 0}, {"x": 0, "y": 90}],
        "right_lane_boundary": [{"x": 4, "y": 0}, {"x": 4, "y": 90}]}"#;
    let map = format!(r#"{{"lane_segments": {{"1": {lane}}}}}"#);
    for (id, map) in [("a", Some(map.as_str())), ("b", Some(&map[..80])), ("c", None)] {
        let scenario = folder.path().join("val").join(id);
        fs_err::create_dir_all(&scenario).expect("writable");
        fs_err::write(scenario.join(format!("scenario_{id}.parquet")), scenario_bytes(id)).expect("writable");
        if let Some(map) = map {
            fs_err::write(scenario.join(format!("log_map_archive_{id}.json")), map).expect("writable");
        }
    }
    let config = IngestConfig::new(Dataset::Argoverse2, vec![folder.path().to_owned()]);
    let (batches, report) = run(&config, None).expect("one scenario is whole");
    assert_eq!((report.n_scenes, batches[0].maps.len()), (1, 1));
    let lanes = batches[0].scenes[0].lanes.lanes();
    assert!(lanes[0].centerline.0[0].distance(crate::geometry::Vec2::new(-49.0, 3.0)) < 1e-9, "in the ego's frame");
    assert!(report.rejects["bad_map"].examples[0].starts_with("val/b/log_map_archive_b.json: "));
    assert!(report.rejects["no_map"].examples[0].starts_with("val/c/scenario_c.parquet: "));
    let without = IngestConfig { maps: MapsConfig::None, ..config };
    // All three are of one scenario.
    let report = run(&without, None).expect("maps are not needed").1;
    assert_eq!((report.n_scenes, report.n_rejects()), (1, 2));
}

#[test]
fn argoverse_1_archives_are_read_completely() {
    for (archive, n_scenes) in [("train", 1990), ("val", 303)] {
        let Some(path) = test_data(&format!("archives/argoverse1_forecasting_{archive}.tar.gz")) else { return };
        let config = IngestConfig { maps: MapsConfig::None, ..config(&path) };
        let report = ingest(&config, None, &Silent, &mut |_| Ok(())).expect("a whole archive");
        assert_eq!((report.n_units, report.n_scenes, report.n_rejects()), (n_scenes, n_scenes, 0), "{archive}");
    }
}

#[test]
fn argoverse_1_samples_lie_on_their_map() {
    let Some(path) = test_data("samples/argoverse1") else { return };
    let listed = fs_err::read_to_string(path.join("scenes_on_map.txt")).expect("part of the sample");
    let config = IngestConfig { places: vec!["MIA".to_owned()], map_radius_m: 30.0, ..config(&path) };
    let (batches, report) = run(&config, None).expect("samples on the map");
    let distance_to_lane = |scene: &Scene| {
        assert!(listed.contains(&format!("{}.csv", scene.source.case_id)), "{} lies on the map", scene.id);
        let projections =
            scene.lanes.lanes().iter().filter_map(|lane| lane.centerline.project(crate::geometry::Vec2::ZERO));
        projections.map(|p| p.offset_m.abs()).fold(f64::INFINITY, f64::min)
    };
    let mut distances: Vec<f64> = scenes(&batches).iter().map(distance_to_lane).collect();
    distances.sort_by(f64::total_cmp);
    assert!(distances[distances.len() / 2] < 1.0, "most egos drive on a lane: {distances:?}");
    assert!(report.n_scenes > 0 && report.rejects.keys().all(|reason| reason == "no_lanes_in_radius"), "{report:?}");
}

#[test]
fn the_argoverse_2_sample_is_read_with_its_map() {
    let Some(path) = test_data("samples/argoverse2") else { return };
    let (batches, report) = run(&IngestConfig::new(Dataset::Argoverse2, vec![path]), None).expect("one scenario");
    assert_eq!((report.n_scenes, report.n_rejects()), (1, 0));
    let scene = &batches[0].scenes[0];
    assert_eq!((scene.n_timesteps, scene.n_history, scene.ego().id.0.as_str()), (110, 50, "138951"));
    assert_eq!((batches[0].maps.len(), batches[0].maps[0].1.lanes().len()), (1, 34), "driving lanes only");
    assert!(!scene.lanes.is_empty() && report.dropped["agents_static"] > 0);
}

#[test]
fn a_blank_place_is_called_none() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut text = String::from("id,t,x,y,l,w,place\n");
    for (i, id) in (0..60).flat_map(|i| [(i, 1), (i, 2)]) {
        let t = f64::from(i) / 10.0;
        text += &format!("{id},{t:.1},{:.2},{},4.5,1.8,\n", 10.0 * t, 4 * id);
    }
    fs_err::write(folder.path().join("a.csv"), text).expect("writable");
    let columns =
        "columns = { track = 'id', time = 't', x = 'x', y = 'y', length = 'l', width = 'w', place = 'place' }";
    let toml = format!("dataset = 'table'\ninputs = [{:?}]\nmaps = 'none'\n[table]\n{columns}", folder.path());
    let (batches, _) = run(&toml::from_str(&toml).expect("a mapping"), None).expect("a table");
    let scene = &scenes(&batches)[0];
    assert_eq!((scene.source.place.as_str(), scene.id.0.as_str()), ("none", "table/train/none/a@0"));
}
