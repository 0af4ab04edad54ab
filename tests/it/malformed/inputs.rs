//! Small inputs as they should be, most of them files in `inputs`.

use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Names below a folder, and what is in them.
pub(super) type Files = BTreeMap<String, Vec<u8>>;

/// Recordings with what they need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Input {
    /// A table in CSV, of which the mapping is in `p.toml`.
    Csv,
    /// The table in Parquet.
    Parquet,
    /// With classes and sizes in a table of tracks.
    Pair,
    /// With a map in OpenDRIVE.
    OpenDrive,
    /// With a map in Lanelet2.
    Lanelet2,
    CommonRoad,
    Interaction,
    Argoverse1,
    Argoverse2,
}

impl Input {
    pub(super) const ALL: [Self; 9] = [
        Self::Csv,
        Self::Parquet,
        Self::Pair,
        Self::OpenDrive,
        Self::Lanelet2,
        Self::CommonRoad,
        Self::Interaction,
        Self::Argoverse1,
        Self::Argoverse2,
    ];

    /// Arguments of the program.
    pub(super) fn args(self) -> &'static [&'static str] {
        match self {
            Self::Csv | Self::Parquet | Self::Pair => &["--dataset", "table", "--set", "ingest.maps=none"],
            Self::OpenDrive | Self::Lanelet2 => &["--dataset", "table"],
            Self::CommonRoad => &["--dataset", "commonroad"],
            Self::Interaction => &["--dataset", "interaction"],
            Self::Argoverse1 => &["--dataset", "argoverse1"],
            Self::Argoverse2 => &["--dataset", "argoverse2"],
        }
    }

    /// Files that are another recording under another name.
    pub(super) fn second(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Csv | Self::OpenDrive | Self::Lanelet2 => &[(CSV, "recordings/train/b.csv")],
            Self::Parquet => &[(PARQUET, "recordings/train/b.parquet")],
            Self::Pair => &[(CSV, "recordings/train/b.csv"), (META, "recordings/train/b.meta")],
            Self::CommonRoad => &[(XML, "recordings/b.xml")],
            Self::Interaction => {
                &[(VEHICLES, "recordings/recorded_trackfiles/FIX_Intersection/vehicle_tracks_001.csv")]
            }
            Self::Argoverse1 => &[(ARGOVERSE1, "recordings/train/data/2.csv")],
            Self::Argoverse2 => &[],
        }
    }

    pub(super) fn files(self) -> Files {
        match self {
            Self::Csv => ours("csv", &[MAPPING, CSV]),
            Self::Parquet => {
                let table = parquet(&["id", "t", "x", "y", "h", "l", "w", "c"], &[]);
                ours("parquet", &[MAPPING]).into_iter().chain([(PARQUET.to_owned(), table)]).collect()
            }
            Self::Pair => ours("pair", &[MAPPING, CSV, META]),
            Self::OpenDrive => ours("opendrive", &[MAPPING, CSV, XODR]),
            Self::Lanelet2 => ours("lanelet2", &[MAPPING, CSV, OSM]),
            Self::CommonRoad => ours("commonroad", &[XML]),
            Self::Interaction => fixtures("interaction_v1_1", &[VEHICLES, MAP]),
            Self::Argoverse1 => fixtures("argoverse1", &[ARGOVERSE1, ARGOVERSE1_MAP]),
            Self::Argoverse2 => fixtures("argoverse2", &[ARGOVERSE2, ARGOVERSE2_MAP]),
        }
    }
}

pub(super) const MAPPING: &str = "p.toml";
pub(super) const CSV: &str = "recordings/train/a.csv";
pub(super) const META: &str = "recordings/train/a.meta";
pub(super) const PARQUET: &str = "recordings/train/a.parquet";
pub(super) const XODR: &str = "recordings/town.xodr";
pub(super) const OSM: &str = "recordings/town.osm";
pub(super) const XML: &str = "recordings/a.xml";
pub(super) const VEHICLES: &str = "recordings/recorded_trackfiles/FIX_Intersection/vehicle_tracks_000.csv";
pub(super) const MAP: &str = "recordings/maps/FIX_Intersection.osm";
pub(super) const ARGOVERSE1: &str = "recordings/train/data/1.csv";
pub(super) const ARGOVERSE1_MAP: &str = "recordings/map_files/pruned_argoverse_MIA_10316_vector_map.xml";
pub(super) const ARGOVERSE2: &str =
    "recordings/5f1d0000-0000-4000-8000-00000000f1d5/scenario_5f1d0000-0000-4000-8000-00000000f1d5.parquet";
pub(super) const ARGOVERSE2_MAP: &str =
    "recordings/5f1d0000-0000-4000-8000-00000000f1d5/log_map_archive_5f1d0000-0000-4000-8000-00000000f1d5.json";

/// Files of the folder `inputs`.
fn ours(folder: &str, names: &[&str]) -> Files {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/malformed/inputs").join(folder);
    names.iter().map(|name| ((*name).to_owned(), fs_err::read(root.join(name)).unwrap())).collect()
}

/// Files of the recordings that other tests read, too.
fn fixtures(folder: &str, names: &[&str]) -> Files {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/recordings").join(folder);
    let read = |name: &&str| fs_err::read(root.join(name.strip_prefix("recordings/").unwrap())).unwrap();
    names.iter().map(|name| ((*name).to_owned(), read(name))).collect()
}

/// The drive of `csv` in Parquet, with these columns, of which some are text.
pub(super) fn parquet(columns: &[&str], texts: &[&str]) -> Vec<u8> {
    let numbers = |of: fn(f64) -> f64| (0..60).map(|i| of(f64::from(i))).collect::<Vec<f64>>();
    let column = |name: &&str| -> (String, ArrayRef) {
        let values = match *name {
            "id" => numbers(|_| 7.0),
            "t" => numbers(|i| i / 10.0),
            "x" => numbers(|i| i),
            "y" => numbers(|_| -1.75),
            "l" => numbers(|_| 4.5),
            "w" => numbers(|_| 1.8),
            _ => numbers(|_| 0.0),
        };
        let array: ArrayRef = match *name {
            "id" => Arc::new(StringArray::from(vec!["7"; 60])),
            "c" => Arc::new(StringArray::from(vec!["car"; 60])),
            name if texts.contains(&name) => Arc::new(StringArray::from(vec!["north"; 60])),
            _ => Arc::new(Float64Array::from(values)),
        };
        ((*name).to_owned(), array)
    };
    let batch = RecordBatch::try_from_iter(columns.iter().map(column)).unwrap();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    bytes
}
