//! Small inputs as they should be.

use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use std::collections::BTreeMap;
use std::fmt::Write as _;
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
        let table = |mapping: &str| vec![(CSV, csv("id,t,x,y,h,l,w,c")), (MAPPING, mapping.to_owned())];
        let text = match self {
            Self::Csv => table(&mapping("*.csv", ", length = 'l', width = 'w', class = 'c'", "")),
            Self::Parquet => vec![(MAPPING, mapping("*.parquet", ", length = 'l', width = 'w', class = 'c'", ""))],
            Self::Pair => {
                let mapping = mapping("*.csv", ", length = 'long', width = 'wide', class = 'kind'", "*.meta");
                [table(&mapping), vec![(META, "id,long,wide,kind\n7,4.5,1.8,car\n".to_owned())]].concat()
            }
            Self::OpenDrive => [table(&mapping("*.csv", "", "")), vec![(XODR, xodr())]].concat(),
            Self::Lanelet2 => [table(&mapping("*.csv", "", "")), vec![(OSM, osm())]].concat(),
            Self::CommonRoad => vec![(XML, commonroad())],
            Self::Interaction => vec![
                (VEHICLES, fixture(&format!("interaction_v1_1/{}", &VEHICLES[11..]))),
                (MAP, fixture(&format!("interaction_v1_1/{}", &MAP[11..]))),
            ],
            Self::Argoverse1 => vec![
                (ARGOVERSE1, fixture(&format!("argoverse1/{}", &ARGOVERSE1[11..]))),
                (ARGOVERSE1_MAP, fixture(&format!("argoverse1/{}", &ARGOVERSE1_MAP[11..]))),
            ],
            Self::Argoverse2 => vec![(ARGOVERSE2_MAP, fixture(&format!("argoverse2/{}", &ARGOVERSE2_MAP[11..])))],
        };
        let mut files: Files = text.into_iter().map(|(name, text)| (name.to_owned(), text.into_bytes())).collect();
        let binary = match self {
            Self::Parquet => Some((PARQUET, parquet(&["id", "t", "x", "y", "h", "l", "w", "c"], &[]))),
            Self::Argoverse2 => Some((ARGOVERSE2, bytes(&format!("argoverse2/{}", &ARGOVERSE2[11..])))),
            _ => None,
        };
        files.extend(binary.map(|(name, bytes)| (name.to_owned(), bytes)));
        files
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

fn bytes(name: &str) -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/recordings");
    fs_err::read(root.join(name)).unwrap()
}

fn fixture(name: &str) -> String {
    String::from_utf8(bytes(name)).unwrap()
}

/// A mapping of columns with one-letter names.
fn mapping(files: &str, columns: &str, track_files: &str) -> String {
    let classes = if columns.contains("class") { "classes = { car = 'vehicle' }\n" } else { "" };
    let track_files = if track_files.is_empty() { String::new() } else { format!("track_files = '{track_files}'\n") };
    format!(
        "[ingest]\ndataset = 'table'\n\n[ingest.table]\nfiles = '{files}'\n{track_files}place = 'town'\n\
         heading = 'degrees'\n{classes}\
         columns = {{ track = 'id', time = 't', x = 'x', y = 'y', heading = 'h'{columns} }}\n"
    )
}

/// Six seconds of a car that drives along x at 10 m/s.
fn csv(header: &str) -> String {
    (0..60).fold(format!("{header}\n"), |mut text, i| {
        writeln!(text, "7,{},{i},-1.75,0,4.5,1.8,car", f64::from(i) / 10.0).unwrap();
        text
    })
}

/// The drive of [`csv`] in Parquet, with these columns, of which some are text.
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

/// A road of 40 m that goes on in one of 60 m, a lane along each.
fn xodr() -> String {
    let road = |id: i32, from: i32, length: i32, links: &str, lane_links: &str| {
        format!(
            "<road id='{id}' length='{length}' junction='-1'>\n<link>{links}</link>\n<planView>\n\
             <geometry s='0' x='{from}' y='0' hdg='0' length='{length}'><line/></geometry>\n</planView>\n<lanes>\n\
             <laneSection s='0'>\n<right>\n<lane id='-1' type='driving'>\n<link>{lane_links}</link>\n\
             <width sOffset='0' a='3.5' b='0' c='0' d='0'/>\n</lane>\n</right>\n</laneSection>\n</lanes>\n</road>\n"
        )
    };
    let one =
        road(1, -20, 40, "<successor elementType='road' elementId='2' contactPoint='start'/>", "<successor id='-1'/>");
    let two =
        road(2, 20, 60, "<predecessor elementType='road' elementId='1' contactPoint='end'/>", "<predecessor id='-1'/>");
    format!("<?xml version='1.0'?>\n<OpenDRIVE>\n<header revMajor='1' revMinor='6'/>\n{one}{two}</OpenDRIVE>\n")
}

/// Two lanelets, one after the other.
fn osm() -> String {
    let mut text = "<?xml version='1.0'?>\n<osm version='0.6'>\n".to_owned();
    for (i, x) in [-20, 20, 80].into_iter().enumerate() {
        writeln!(text, "<node id='{}' x='{x}' y='0'/>\n<node id='{}' x='{x}' y='-3.5'/>", 1 + 2 * i, 2 + 2 * i)
            .unwrap();
    }
    for (id, nodes) in [(11, [1, 3]), (12, [2, 4]), (13, [3, 5]), (14, [4, 6])] {
        writeln!(text, "<way id='{id}'><nd ref='{}'/><nd ref='{}'/></way>", nodes[0], nodes[1]).unwrap();
    }
    for (id, [left, right]) in [(21, [11, 12]), (22, [13, 14])] {
        writeln!(
            text,
            "<relation id='{id}'>\n<member type='way' role='left' ref='{left}'/>\n\
             <member type='way' role='right' ref='{right}'/>\n<tag k='type' v='lanelet'/>\n</relation>"
        )
        .unwrap();
    }
    text + "</osm>\n"
}

/// Two lanelets, and two cars for six seconds.
fn commonroad() -> String {
    let point = |x: f64, y: f64| format!("<point><x>{x}</x><y>{y}</y></point>");
    let mut text = "<?xml version='1.0'?>\n<commonRoad benchmarkID='USA_Some-3_2_T-1' commonRoadVersion='2020a' \
                    timeStepSize='0.1'>\n"
        .to_owned();
    for (id, [from, to], link) in
        [(1, [-20.0, 20.0], "<successor ref='2'/>"), (2, [20.0, 80.0], "<predecessor ref='1'/>")]
    {
        writeln!(text, "<lanelet id='{id}'>").unwrap();
        for (name, y) in [("leftBound", 0.0), ("rightBound", -3.5)] {
            writeln!(text, "<{name}>{}{}</{name}>", point(from, y), point(to, y)).unwrap();
        }
        writeln!(text, "{link}\n<laneletType>urban</laneletType>\n</lanelet>").unwrap();
    }
    for (id, ahead) in [(7, 0.0), (8, 15.0)] {
        writeln!(
            text,
            "<dynamicObstacle id='{id}'>\n<type>car</type>\n\
             <shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>"
        )
        .unwrap();
        for i in 0..60 {
            let name = if i == 0 { "initialState" } else { "state" };
            let open = if i == 1 { "<trajectory>\n" } else { "" };
            writeln!(
                text,
                "{open}<{name}><position>{}</position><orientation><exact>0.0</exact></orientation>\
                 <time><exact>{i}</exact></time><velocity><exact>10.0</exact></velocity></{name}>",
                point(ahead + f64::from(i), -1.75)
            )
            .unwrap();
        }
        text += "</trajectory>\n</dynamicObstacle>\n";
    }
    text + "</commonRoad>\n"
}
