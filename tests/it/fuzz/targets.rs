//! The readers, and the files that they are given to start from.

use djinn::ingest::archive::visit_entries;
use djinn::ingest::{IngestConfig, MapsConfig, ingest, lanelet2};
use djinn::metrics::MetricRow;
use djinn::model::{NetworkConfig, TrainedDenoiser};
use djinn::nn::{Compute, Params};
use djinn::pipeline::config::parse;
use djinn::progress::Silent;
use djinn::scene::Dataset;
use djinn::seed::Seed;
use djinn::store::{CorpusReader, FileStamp, SceneStore, SceneWriter, stream_table};
use flate2::write::GzEncoder;
use serde_json::Value;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

pub(super) struct Target {
    pub(super) name: &'static str,
    /// Files as they should be. They may be made in the folder, which belongs to the target.
    pub(super) seeds: fn(&Path) -> Vec<Vec<u8>>,
    /// Reads such bytes, which it may put into the folder. Whether they could be read.
    pub(super) read: fn(&Path, &[u8]) -> bool,
}

pub(super) const TARGETS: &[Target] = &[
    Target {
        name: "interaction_cases",
        seeds: cases,
        read: |folder, bytes| interaction(folder, &[("FIX_val.csv", bytes)]),
    },
    Target {
        name: "interaction_vehicles",
        seeds: |_| vec![head(VEHICLES, 60)],
        read: |folder, bytes| interaction(folder, &[("FIX/vehicle_tracks_000.csv", bytes)]),
    },
    Target {
        name: "interaction_pedestrians",
        seeds: |folder| {
            write(folder, "vehicles", &head(VEHICLES, 60));
            vec![head(&VEHICLES.replace("vehicle_", "pedestrian_"), 60)]
        },
        read: |folder, bytes| {
            let vehicles = fs_err::read(folder.join("vehicles")).unwrap();
            let files = [("FIX/pedestrian_tracks_000.csv", bytes), ("FIX/vehicle_tracks_000.csv", vehicles.as_slice())];
            interaction(folder, &files)
        },
    },
    Target {
        name: "table",
        seeds: |_| vec![head(VEHICLES, 60)],
        read: |folder, bytes| {
            write(folder, "tracks.csv", bytes);
            let mapping = "time_unit_s = 0.001
                columns = { track = 'track_id', time = 'timestamp_ms', x = 'x', y = 'y', heading = 'psi_rad' }";
            let table = Some(toml::from_str(mapping).unwrap());
            let config = IngestConfig::new(Dataset::Table, vec![folder.to_owned()]);
            let config =
                IngestConfig { table, maps: MapsConfig::None, n_history: Some(2), n_future: Some(3), ..config };
            is_ingested(&config)
        },
    },
    Target { name: "zip", seeds: zipped, read: |folder, bytes| entries(folder, "input.zip", bytes) },
    Target { name: "tar_gz", seeds: tarball, read: |folder, bytes| entries(folder, "input.tar.gz", bytes) },
    Target {
        name: "lanelet2_map",
        seeds: |_| ["osm", "osm_xy"].map(|kind| fixture(&format!("{RECORDED}/maps/FIX_Intersection.{kind}"))).to_vec(),
        read: |_, mut bytes| {
            let Ok((graph, _)) = lanelet2::read_map(&mut bytes, "input.osm") else { return false };
            let lines = graph.lanes().iter().flat_map(|lane| [&lane.centerline, &lane.left, &lane.right]);
            assert!(lines.flat_map(|line| &line.0).all(|point| point.is_finite()));
            true
        },
    },
    Target {
        name: "argoverse1_tracks",
        seeds: |_| vec![fixture(&format!("{ARGOVERSE1}/train/data/1.csv"))],
        read: |folder, bytes| ingested((folder, "train/data/1.csv"), bytes, Dataset::Argoverse1, MapsConfig::None),
    },
    Target {
        name: "argoverse1_map",
        seeds: |folder| {
            write(folder, "train/data/1.csv", &fixture(&format!("{ARGOVERSE1}/train/data/1.csv")));
            vec![fixture(&format!("{ARGOVERSE1}/map_files/{ARGOVERSE1_MAP}"))]
        },
        read: |folder, bytes| ingested((folder, ARGOVERSE1_MAP), bytes, Dataset::Argoverse1, MapsConfig::default()),
    },
    Target {
        name: "argoverse2_tracks",
        seeds: |_| vec![fixture(&argoverse2("scenario_", "parquet"))],
        read: |folder, bytes| {
            let name = format!("{LOG}/scenario_{LOG}.parquet");
            ingested((folder, &name), bytes, Dataset::Argoverse2, MapsConfig::None)
        },
    },
    Target {
        name: "argoverse2_map",
        seeds: |folder| {
            write(folder, &format!("{LOG}/scenario_{LOG}.parquet"), &fixture(&argoverse2("scenario_", "parquet")));
            vec![fixture(&argoverse2("log_map_archive_", "json"))]
        },
        read: |folder, bytes| {
            let name = format!("{LOG}/log_map_archive_{LOG}.json");
            ingested((folder, &name), bytes, Dataset::Argoverse2, MapsConfig::default())
        },
    },
    Target {
        name: "tfrecord",
        seeds: |_| vec![fixture(WOMD)],
        read: |folder, bytes| ingested((folder, "testing.tfrecord"), bytes, Dataset::Womd, MapsConfig::None),
    },
    Target {
        name: "womd_scenario",
        seeds: |_| {
            // The content of the only record, between its head and its checksum.
            let file = fixture(WOMD);
            vec![file[12..file.len() - 4].to_vec()]
        },
        read: |folder, bytes| {
            ingested((folder, "testing.tfrecord"), &record(bytes), Dataset::Womd, MapsConfig::default())
        },
    },
    Target {
        name: "checkpoint",
        seeds: |folder| vec![small_model(folder)],
        read: |folder, bytes| {
            let path = write(folder, "model.safetensors", bytes);
            TrainedDenoiser::read(&path, &Compute::cpu()).is_ok()
        },
    },
    Target {
        name: "metrics_table",
        seeds: |_| vec![fixture(&format!("{CORPUS}/metrics.parquet"))],
        read: |folder, bytes| {
            let rows = stream_table::<MetricRow>(&write(folder, "metrics.parquet", bytes));
            rows.is_ok_and(|mut rows| rows.all(|row| row.is_ok()))
        },
    },
    Target {
        name: "corpus_manifest",
        seeds: corpus_manifest,
        read: |folder, bytes| {
            write(folder, "corpus/manifest.json", bytes);
            read_corpus(&folder.join("corpus"))
        },
    },
    Target {
        name: "corpus_scenarios",
        seeds: corpus_scenarios,
        read: |folder, bytes| {
            put_stamped(folder, &folder.join("corpus"), SCENARIOS, bytes);
            read_corpus(&folder.join("corpus"))
        },
    },
    Target {
        name: "scene_shard",
        seeds: scene_shard,
        read: |folder, bytes| {
            put_stamped(folder, &folder.join("scenes"), SHARD, bytes);
            read_scenes(&folder.join("scenes"))
        },
    },
    Target {
        name: "pipeline_toml",
        seeds: |_| {
            let files = ["quickstart", "cut_in_request", "few_evaluations", "lane_changes_argoverse1"];
            let carried = files.map(|name| fixture(&format!("pipelines/{name}.toml")));
            carried.into_iter().chain([crate::support::SMALL_PIPELINE.as_bytes().to_vec()]).collect()
        },
        read: |_, bytes| std::str::from_utf8(bytes).is_ok_and(|text| parse(None, text, &[]).is_ok()),
    },
];

const RECORDED: &str = "tests/fixtures/recordings/interaction_v1_1";
const VEHICLES: &str =
    "tests/fixtures/recordings/interaction_v1_1/recorded_trackfiles/FIX_Intersection/vehicle_tracks_000.csv";
const ARGOVERSE1: &str = "tests/fixtures/recordings/argoverse1";
const ARGOVERSE1_MAP: &str = "pruned_argoverse_MIA_10316_vector_map.xml";
const WOMD: &str = "tests/fixtures/recordings/womd/testing/testing.tfrecord-00000-of-00001";
const LOG: &str = "5f1d0000-0000-4000-8000-00000000f1d5";
const CORPUS: &str = "tests/fixtures/corpus/cut_ins";
const SHARD: &str = "scenes-00000.arrow";
const SCENARIOS: &str = "scenarios/behavior=cut_in/place=FIX_Merging/part-00000.parquet";

fn argoverse2(prefix: &str, extension: &str) -> String {
    format!("tests/fixtures/recordings/argoverse2/{LOG}/{prefix}{LOG}.{extension}")
}

fn fixture(path: &str) -> Vec<u8> {
    fs_err::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// Its first lines: what is wrong with a table is wrong with a small one, and small ones are read more often.
fn head(path: &str, n_lines: usize) -> Vec<u8> {
    fixture(path).split_inclusive(|byte| *byte == b'\n').take(n_lines).flatten().copied().collect()
}

/// Writes a file below the folder and returns where it is.
fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs_err::create_dir_all(path.parent().unwrap()).unwrap();
    fs_err::write(&path, bytes).unwrap();
    path
}

fn record(content: &[u8]) -> Vec<u8> {
    let checksum = |bytes: &[u8]| crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes();
    let length = (content.len() as u64).to_le_bytes();
    [&length, &checksum(&length)[..], content, &checksum(content)].concat()
}

/// Whether the folder's recordings give a scene, with these bytes in the file of this name.
fn ingested((folder, name): (&Path, &str), bytes: &[u8], dataset: Dataset, maps: MapsConfig) -> bool {
    write(folder, name, bytes);
    is_ingested(&IngestConfig { maps, ..IngestConfig::new(dataset, vec![folder.to_owned()]) })
}

/// Whether there is a scene. Whatever is read is finite, and as long as its scene.
fn is_ingested(config: &IngestConfig) -> bool {
    let read = ingest(config, None, &Silent, &mut |batch| {
        for scene in batch.scenes {
            for track in &scene.tracks {
                assert_eq!(track.trajectory.n_timesteps(), scene.n_timesteps);
                assert!(track.trajectory.valid().all(|(_, state)| state.is_finite()));
            }
        }
        Ok(())
    });
    read.is_ok()
}

fn interaction(folder: &Path, files: &[(&str, &[u8])]) -> bool {
    let root = folder.join("recordings");
    for (name, bytes) in files {
        write(&root, name, bytes);
    }
    let config = IngestConfig {
        maps: MapsConfig::None,
        n_history: Some(2),
        n_future: Some(3),
        window_stride: 1,
        ..IngestConfig::new(Dataset::Interaction, vec![root])
    };
    is_ingested(&config)
}

/// Tables of cases: in order, scattered, and of a test set.
fn cases(_: &Path) -> Vec<Vec<u8>> {
    let header = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";
    let row = |case: u32, track: u32, frame: u32| {
        format!("{case}.0,{track},{frame},{frame}00,car,{frame}.5,-2.25,10.0,0.1,0.01,4.5,1.8")
    };
    let table = |header: &str, rows: Vec<String>| format!("{header}\n{}\n", rows.join("\n")).into_bytes();
    let in_order =
        (1..4).flat_map(|case| (1..3).flat_map(move |track| (8..14).map(move |frame| row(case, track, frame))));
    let marked = (8..11).map(|frame| format!("{},1.0,0.0", row(1, 1, frame)));
    vec![
        table(header, in_order.collect()),
        table(&format!("{header},track_to_predict,interesting_agent"), marked.collect()),
    ]
}

/// Whether all entries of an archive can be read.
fn entries(folder: &Path, name: &str, bytes: &[u8]) -> bool {
    let path = write(folder, name, bytes);
    let mut is_read = true;
    let visited = visit_entries(&[path], &|_| true, &mut |_, reader| {
        let mut limited = std::io::Read::take(reader, 16 << 20);
        is_read &= std::io::copy(&mut limited, &mut std::io::sink()).is_ok();
        Ok(ControlFlow::Continue(()))
    });
    is_read && visited.is_ok()
}

/// Files of archives, by their names: one of them too long for a plain header of tar.
fn small_files() -> Vec<(String, Vec<u8>)> {
    let names = ["train/data/1.csv".to_owned(), format!("{}/2.csv", "x".repeat(120)), "notes.txt".to_owned()];
    names.into_iter().map(|name| (name.clone(), name.repeat(50).into_bytes())).collect()
}

fn zipped(_: &Path) -> Vec<Vec<u8>> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in small_files() {
        archive.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(&content).unwrap();
    }
    vec![archive.finish().unwrap().into_inner()]
}

fn tarball(_: &Path) -> Vec<Vec<u8>> {
    let mut archive = tar::Builder::new(GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    for (name, content) in small_files() {
        let mut header = tar::Header::new_gnu();
        header.set_size(content.len() as u64);
        archive.append_data(&mut header, name, content.as_slice()).unwrap();
    }
    vec![archive.into_inner().unwrap().finish().unwrap()]
}

/// A checkpoint of a network that is as small as one can be, with what a bundled model says of itself.
fn small_model(folder: &Path) -> Vec<u8> {
    let compute = Compute::cpu();
    let carried = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/models/simulated_places.safetensors");
    let mut spec = TrainedDenoiser::read(&carried, &compute).unwrap().spec;
    spec.network =
        NetworkConfig { layers: "T".into(), width: 4, n_heads: 1, feed_forward: 4, encoding: 2, ..spec.network };
    let mut params = Params::new(&compute);
    djinn::model::ModelSpec::build(&spec, &mut params, Seed(1)).unwrap();
    let path = folder.join("small.safetensors");
    djinn::model::ModelSpec::write(&spec, &params, &path).unwrap();
    fs_err::read(path).unwrap()
}

/// Puts the corpus of the fixtures into the folder.
fn copy_corpus(folder: &Path) {
    let files = crate::support::files(&Path::new(env!("CARGO_MANIFEST_DIR")).join(CORPUS));
    crate::support::write_all(&files, &folder.join("corpus"));
}

fn corpus_manifest(folder: &Path) -> Vec<Vec<u8>> {
    copy_corpus(folder);
    vec![fixture(&format!("{CORPUS}/manifest.json"))]
}

fn corpus_scenarios(folder: &Path) -> Vec<Vec<u8>> {
    copy_corpus(folder);
    keep_whole(folder, &folder.join("corpus"), SCENARIOS)
}

fn read_corpus(root: &Path) -> bool {
    let Ok(corpus) = CorpusReader::open(root) else { return false };
    (0..corpus.len().min(3)).all(|i| corpus.scenario(i).is_ok())
}

fn scene_shard(folder: &Path) -> Vec<Vec<u8>> {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join(ARGOVERSE1).join("train");
    let config = IngestConfig { maps: MapsConfig::None, ..IngestConfig::new(Dataset::Argoverse1, vec![recordings]) };
    let root = folder.join("scenes");
    let (mut writer, _) = SceneWriter::resume(&root).unwrap();
    let report = ingest(&config, None, &Silent, &mut |batch| {
        Ok(writer.write_batch(&batch.scenes, &batch.maps, batch.units_done, &serde_json::Value::Null)?)
    });
    writer.finish(&serde_json::to_value(report.unwrap()).unwrap()).unwrap();
    keep_whole(folder, &root, SHARD)
}

fn read_scenes(root: &Path) -> bool {
    let Ok(store) = SceneStore::open(root) else { return false };
    (0..store.index().len()).all(|i| store.scene(i).is_ok())
}

/// Keeps the file `name` of a folder of ours and its manifest as they are, and returns the file.
fn keep_whole(folder: &Path, root: &Path, name: &str) -> Vec<Vec<u8>> {
    let bytes = fs_err::read(root.join(name)).unwrap();
    write(folder, "whole", &bytes);
    write(folder, "whole.json", &fs_err::read(root.join("manifest.json")).unwrap());
    vec![bytes]
}

/// Puts other bytes in the place of the file, and their checksum into the manifest: else it would report any damage
/// before a reader meets it.
fn put_stamped(folder: &Path, root: &Path, name: &str, bytes: &[u8]) {
    fn restamp(value: &mut Value, old: &FileStamp, new: &FileStamp) {
        match value {
            Value::Object(fields) => {
                if fields.get("checksum").and_then(Value::as_str) == Some(&old.checksum) {
                    fields.insert("checksum".to_owned(), new.checksum.clone().into());
                    fields.insert("n_bytes".to_owned(), new.n_bytes.into());
                }
                fields.values_mut().for_each(|value| restamp(value, old, new));
            }
            Value::Array(values) => values.iter_mut().for_each(|value| restamp(value, old, new)),
            _ => {}
        }
    }
    let mut manifest = crate::support::json(&folder.join("whole.json"));
    restamp(&mut manifest, &FileStamp::of(&fs_err::read(folder.join("whole")).unwrap()), &FileStamp::of(bytes));
    write(root, name, bytes);
    write(root, "manifest.json", manifest.to_string().as_bytes());
}
