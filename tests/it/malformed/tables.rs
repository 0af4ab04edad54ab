//! What can be wrong with tables and their mappings.

use super::cases::Edit::{Bytes, Cut, Gone, Made, Replace, Whole};
use super::cases::Then::{Ends, GoesOn, Rejected};
use super::cases::{Case, case, in_milliseconds, text};
use super::inputs::{ARGOVERSE1, CSV, Input, MAPPING, META, PARQUET, VEHICLES, parquet};

const MAPPED: (Input, &str) = (Input::Csv, MAPPING);
const TABLE: (Input, &str) = (Input::Csv, CSV);
const COLUMNS: (Input, &str) = (Input::Parquet, PARQUET);
const OF_TRACKS: (Input, &str) = (Input::Pair, META);
const TRACKS: (Input, &str) = (Input::Interaction, VEHICLES);
const SEQUENCE: (Input, &str) = (Input::Argoverse1, ARGOVERSE1);

pub(super) const CASES: &[Case] = &[
    // Mappings.
    case("no column for x", MAPPED, Replace(&[(", x = 'x'", "")]), Ends, &["p.toml:9:", "missing field `x`"]),
    case(
        "an unknown unit",
        MAPPED,
        Replace(&[("'degrees'", "'gradians'")]),
        Ends,
        &["p.toml:7:", "gradians", "known here: radians, degrees, compass_degrees"],
    ),
    case(
        "an unknown class",
        MAPPED,
        Replace(&[("car = 'vehicle'", "car = 'spaceship'")]),
        Ends,
        &["p.toml:8:", "spaceship", "known here: vehicle, bus"],
    ),
    case(
        "a misspelled key",
        MAPPED,
        Replace(&[("place =", "plcae =")]),
        Ends,
        &["p.toml:6:", "plcae", "did you mean `place`?"],
    ),
    case(
        "a unit of zero",
        MAPPED,
        Replace(&[("place =", "time_unit_s = 0\nplace =")]),
        Ends,
        &["p.toml:6:", "ingest.table.time_unit_s is 0, expected 0.000000001 to 1000"],
    ),
    case(
        "a unit that is no number",
        MAPPED,
        Replace(&[("place =", "length_unit_m = nan\nplace =")]),
        Ends,
        &["p.toml:6:", "ingest.table.length_unit_m", "expected"],
    ),
    case(
        "columns as a list",
        MAPPED,
        Replace(&[("columns = {", "columns = ['id'] #")]),
        Ends,
        &["p.toml:9:", "ingest.table.columns is a list, expected a table"],
    ),
    case(
        "files that are not there",
        MAPPED,
        Replace(&[("'*.csv'", "'track_*.csv'")]),
        Ends,
        &["ingest.table.files", "`track_*.csv`", "such as train/a.csv"],
    ),
    case(
        "one column for two",
        MAPPED,
        Replace(&[("y = 'y'", "y = 'x'")]),
        Ends,
        &["ingest.table.columns", "has \"x\" for two of track, x, y"],
    ),
    case(
        "a mapping in Latin-1",
        MAPPED,
        Made(|bytes| [b"# stra\xdfe\n", bytes].concat()),
        Ends,
        &["p.toml:1: is not in UTF-8", "save the file in that encoding"],
    ),
    // Tables in CSV.
    case("an empty table", TABLE, Whole(""), Rejected, &["train/a.csv", "is empty"]),
    case("a header alone", TABLE, Whole("id,t,x,y,h,l,w,c\n"), Rejected, &["train/a.csv", "has no rows"]),
    case("a table cut short", TABLE, Cut(98), Rejected, &["train/a.csv", "line 60", "cells, expected 8"]),
    case(
        "a word for a number",
        TABLE,
        Replace(&[(",7,-1.75", ",seven,-1.75")]),
        Rejected,
        &["train/a.csv", "line 9", "column x is \"seven\", expected a number"],
    ),
    case(
        "a blank position",
        TABLE,
        Replace(&[(",7,-1.75", ",,-1.75")]),
        Rejected,
        &["train/a.csv, line 9: column x is blank or NaN, expected a number"],
    ),
    case(
        "a position that is no number",
        TABLE,
        Replace(&[(",7,-1.75", ",nan,-1.75")]),
        Rejected,
        &["train/a.csv, line 9: column x is blank or NaN, expected a number"],
    ),
    case(
        "an infinite position",
        TABLE,
        Replace(&[(",7,-1.75", ",inf,-1.75")]),
        Rejected,
        &["train/a.csv, line 9: column x is inf, expected a number"],
    ),
    case(
        "a position beyond the earth",
        TABLE,
        Replace(&[(",7,-1.75", ",1e300,-1.75")]),
        Rejected,
        &["train/a.csv, line 9: column x is 1e300 m", "ingest.table.length_unit_m"],
    ),
    case(
        "a time beyond all times",
        TABLE,
        Replace(&[("7,0.7,", "7,1e15,")]),
        Rejected,
        &["train/a.csv, line 9: ", "expected at most 100000", "ingest.table.time_unit_s"],
    ),
    case(
        "a time of the largest number",
        TABLE,
        Replace(&[("7,0.7,", "7,1e308,")]),
        Rejected,
        &["train/a.csv, line 9: ", "expected at most 100000", "ingest.table.time_unit_s"],
    ),
    case(
        "milliseconds for seconds",
        TABLE,
        Made(in_milliseconds),
        Rejected,
        &["train/a.csv, line 2: ", "100.000 s apart", "ingest.table.time_unit_s"],
    ),
    case(
        "a column twice",
        TABLE,
        Replace(&[("id,t,x,y", "id,t,x,x")]),
        Rejected,
        &["train/a.csv", "line 1", "the column x appears twice"],
    ),
    case(
        "a column that is missing",
        TABLE,
        Replace(&[("id,t,x,y", "id,t,x,north")]),
        Rejected,
        &["train/a.csv", "no column y", "north", "ingest.table.columns"],
    ),
    case(
        "a decimal comma",
        TABLE,
        Made(|bytes| text(bytes).replace(',', ";").replace('.', ",").into_bytes()),
        Rejected,
        &["train/a.csv: line 2: column y is \"-1,75\", expected a number with a decimal point"],
    ),
    case(
        "mixed separators",
        TABLE,
        Replace(&[("7,0.7,7,-1.75,0,4.5,1.8,car", "7;0.7;7;-1.75;0;4.5;1.8;car")]),
        Rejected,
        &["train/a.csv", "line 9", "1 cells, expected 8"],
    ),
    case(
        "another separator than the header's",
        TABLE,
        Replace(&[("id,t,x,y,h,l,w,c", "id;t;x;y;h;l;w;c")]),
        Rejected,
        &["train/a.csv", "line 2: 1 cells, expected 8 between ';', as in the header"],
    ),
    case(
        "degrees for meters",
        TABLE,
        Made(|bytes| {
            let degrees = |(i, line): (usize, &str)| {
                line.replacen(&format!(",{},-1.75", i as i64 - 1), &format!(",8.40000{i:02},49.01"), 1)
            };
            text(bytes).split_inclusive('\n').enumerate().map(degrees).collect::<String>().into_bytes()
        }),
        GoesOn,
        &["train/a.csv: nobody is ever more than 0.0000 m", "not in degrees", "ingest.table.length_unit_m"],
    ),
    case("an open quote", TABLE, Replace(&[("7,0.7,7", "\"7,0.7,7")]), Rejected, &["train/a.csv: line 9: ", "quote"]),
    case(
        "two places at one time",
        TABLE,
        Replace(&[("7,0.8,8", "7,0.7,8")]),
        Rejected,
        &["train/a.csv", "line 10", "track 7", "ingest.table.columns.recording"],
    ),
    case(
        "an unknown class in a row",
        TABLE,
        Made(|bytes| text(bytes).replace("car", "tram").into_bytes()),
        Rejected,
        &["train/a.csv", "line 2", "\"tram\"", "ingest.table.classes"],
    ),
    case(
        "a class that changes",
        TABLE,
        Replace(&[("7,0.7,7,-1.75,0,4.5,1.8,car", "7,0.7,7,-1.75,0,4.5,1.8,tram")]),
        GoesOn,
        &["train/a.csv: line 9: track 7 is \"tram\", having been \"car\""],
    ),
    case(
        "a negative length",
        TABLE,
        Made(|bytes| text(bytes).replace(",4.5,", ",-4.5,").into_bytes()),
        Rejected,
        &["train/a.csv, line 2: ", "-4.5 by 1.8 m", "expected 0 to 1000"],
    ),
    case(
        "a length of kilometers",
        TABLE,
        Made(|bytes| text(bytes).replace(",4.5,", ",4500,").into_bytes()),
        Rejected,
        &["train/a.csv", "line 2", "4500", "ingest.table.length_unit_m"],
    ),
    case(
        "no ids",
        TABLE,
        Made(|bytes| text(bytes).replace("\n7,", "\n,").into_bytes()),
        Rejected,
        &["train/a.csv", "column id is blank in all rows"],
    ),
    case(
        "UTF-16",
        TABLE,
        Made(|bytes| [0xfeff].into_iter().chain(text(bytes).encode_utf16()).flat_map(u16::to_le_bytes).collect()),
        Rejected,
        &["train/a.csv", "UTF-16", "UTF-8"],
    ),
    case(
        "Latin-1",
        TABLE,
        Made(|bytes| [&bytes[..bytes.len() - 4], b"c\xe4r\n"].concat()),
        Rejected,
        &["train/a.csv", "line 61", "column c is not in UTF-8"],
    ),
    case(
        "no text",
        TABLE,
        Bytes(b"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00"),
        Rejected,
        &["train/a.csv", "no column id", "ingest.table.columns"],
    ),
    case(
        "too short",
        TABLE,
        Made(|bytes| text(bytes).split_inclusive('\n').take(21).collect::<String>().into_bytes()),
        Rejected,
        &["train/a.csv", "20 frames, a scene has 40"],
    ),
    // Tables in Parquet.
    case("Parquet cut short", COLUMNS, Cut(60), Rejected, &["train/a.parquet", "Parquet"]),
    case("a beginning of Parquet", COLUMNS, Bytes(b"PAR1"), Rejected, &["train/a.parquet", "Parquet"]),
    case("an empty Parquet", COLUMNS, Bytes(b""), Rejected, &["train/a.parquet", "is empty"]),
    case(
        "text in a column of numbers",
        COLUMNS,
        Made(|_| parquet(&["id", "t", "x", "y", "h", "l", "w", "c"], &["x"])),
        Rejected,
        &["train/a.parquet: column x is of type text, expected numbers"],
    ),
    case(
        "Parquet without a column",
        COLUMNS,
        Made(|_| parquet(&["id", "t", "x", "north", "h", "l", "w", "c"], &[])),
        Rejected,
        &["train/a.parquet", "no column y", "north", "ingest.table.columns"],
    ),
    // Tables of tracks.
    case("no table of tracks", OF_TRACKS, Gone, Rejected, &["train/a.csv", "a.meta", "ingest.table.track_files"]),
    case(
        "a track that the table lacks",
        OF_TRACKS,
        Replace(&[("\n7,", "\n8,")]),
        Rejected,
        &["train/a.meta", "no row for track 7"],
    ),
    case(
        "a track twice in the table",
        OF_TRACKS,
        Whole("id,long,wide,kind\n7,4.5,1.8,car\n7,9.5,2.5,car\n"),
        Rejected,
        &["train/a.meta, line 3: track 7 is on line 2 already"],
    ),
    case(
        "a size that is a word",
        OF_TRACKS,
        Replace(&[("4.5", "long")]),
        Rejected,
        &["train/a.meta", "line 2", "column long is \"long\", expected a number"],
    ),
    // INTERACTION.
    case(
        "a row cut short",
        TRACKS,
        Replace(&[(",0.060,4.68,1.83\n11,2", ",0.060\n11,2")]),
        Rejected,
        &["vehicle_tracks_000.csv:2: 9 columns, expected 11"],
    ),
    case(
        "a frame that is a word",
        TRACKS,
        Replace(&[("11,2,200", "11,two,200")]),
        Rejected,
        &["vehicle_tracks_000.csv:3: column frame_id is \"two\", expected a number"],
    ),
    case(
        "a frame twice",
        TRACKS,
        Replace(&[("11,2,200", "11,1,100")]),
        Rejected,
        &["vehicle_tracks_000.csv:3: track 11 is at frame 1 already"],
    ),
    case(
        "a header without a column",
        TRACKS,
        Replace(&[("psi_rad", "psi")]),
        Rejected,
        &["vehicle_tracks_000.csv", "psi_rad"],
    ),
    case(
        "an empty recording",
        TRACKS,
        Whole(""),
        Rejected,
        &["vehicle_tracks_000.csv: line 1: no column track_id", "expected `track_id,frame_id"],
    ),
    // Argoverse.
    case("a sequence cut short", SEQUENCE, Cut(50), Rejected, &["train/data/1.csv:263: 2 fields, expected 6"]),
    case(
        "a time that is a word",
        SEQUENCE,
        Replace(&[(
            "315970000.0979882,00000000-0000-0000-0000-000000000000",
            "now,00000000-0000-0000-0000-000000000000",
        )]),
        Rejected,
        &["train/data/1.csv:2: TIMESTAMP is `now`, expected a number"],
    ),
    case(
        "an unknown city",
        SEQUENCE,
        Made(|bytes| text(bytes).replace(",MIA", ",ROM").into_bytes()),
        Ends,
        &["no map for argoverse1/ROM", "ingest.map_inputs"],
    ),
];
