//! The rows of a table, by recording and track.

use super::columns::{Kind, Table, Texts};
use super::mapping::{Plane, TableColumns, TableMapping};
use crate::ingest::raw::{Finding, Part, RawUnit, Reject};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The rows of a file with those of its table of tracks.
pub(super) struct Rows<'a> {
    pub(super) mapping: &'a TableMapping,
    pub(super) plane: Plane,
    pub(super) file: String,
    /// The part of the file that they are.
    pub(super) part: Option<Arc<Part>>,
    pub(super) table: Table,
    pub(super) of_tracks: Option<OfTracks>,
}

/// A table with a row for each track.
pub(super) struct OfTracks {
    pub(super) file: String,
    pub(super) table: Table,
    rows: BTreeMap<String, usize>,
}

/// The rows of one recording: the row indices of each track, in the order of their first rows.
pub(super) struct Group {
    /// Empty if the file is one recording.
    pub(super) recording: String,
    pub(super) place: Option<String>,
    pub(super) tracks: Vec<(u32, Vec<u32>)>,
}

impl<'a> Rows<'a> {
    pub(super) fn read(unit: &RawUnit, mapping: &'a TableMapping) -> Result<Self, Reject> {
        let wanted = wanted(&mapping.columns);
        let read = |file: &str, bytes: &[u8], lines: &[u64]| {
            let bad = |detail: String| Reject { reason: "bad_table", detail: format!("{file}: {detail}") };
            let table = Table::read(bytes, lines, &wanted).map_err(|error| bad(error.to_string()))?;
            table.passed.fault().map_or(Ok(table), |fault| Err(bad(fault)))
        };
        let mut table = read(&unit.file, &unit.bytes, &unit.lines)?;
        table.counted = unit.part.as_ref().map_or(table.counted, |part| part.counted);
        let of_tracks = match &unit.companion {
            Some(companion) => {
                let table = read(&companion.file, &companion.bytes, &[])?;
                let key = &mapping.columns.track;
                let ids = table.text(Some(key)).ok_or_else(|| Reject {
                    reason: "missing_column",
                    detail: format!("{}: {}", companion.file, table.lacks(&[key])),
                })?;
                let mut rows = BTreeMap::new();
                for (row, id) in ids.of_row.iter().enumerate() {
                    let id = &ids.different[*id as usize];
                    if let Some(first) = rows.insert(id.clone(), row) {
                        let [first, again] = [first, row].map(|row| table.place_of(row));
                        let detail = format!("{}, {again}: track {id} is on {first} already", companion.file);
                        return Err(Reject { reason: "duplicate_track", detail });
                    }
                }
                Some(OfTracks { file: companion.file.clone(), table, rows })
            }
            None => None,
        };
        let has = |name: &str, kind: Kind, table: &Table| match kind {
            Kind::Required | Kind::Number => table.number(Some(name)).is_some(),
            Kind::Track | Kind::Text => table.text(Some(name)).is_some(),
            Kind::Types => true,
        };
        let is_missing = |(name, kind): &&(&str, Kind)| {
            let elsewhere = of_tracks.as_ref().filter(|_| !mapping.columns.is_of_rows(name));
            !has(name, *kind, &table) && !elsewhere.is_some_and(|of_tracks| has(name, *kind, &of_tracks.table))
        };
        let missing: Vec<&str> = wanted.iter().filter(is_missing).map(|(name, _)| *name).collect();
        if !missing.is_empty() {
            return Err(unit.reject("missing_column", table.lacks(&missing)));
        }
        if table.n_rows == 0 && table.passed.n_without_track > 0 {
            let key = &mapping.columns.track;
            let detail = format!("column {key} is blank in all rows, expected the id of a track");
            return Err(unit.reject("no_rows", detail));
        }
        if table.n_rows == 0 {
            return Err(unit.reject("no_rows", "the table has no rows"));
        }
        let plane = mapping.plane();
        Ok(Self { mapping, plane, file: unit.file.clone(), part: unit.part.clone(), table, of_tracks })
    }

    /// Doubts about the whole table.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let of_table = match &self.part {
            None => self.table.passed.findings(&self.file),
            Some(part) if part.windows.start == 0 => part.findings.clone(),
            // Those were found with the first part.
            Some(_) => return Vec::new(),
        };
        let of_tracks = self.of_tracks.iter().flat_map(|of| of.table.passed.findings(&of.file));
        of_table.into_iter().chain(of_tracks).chain(self.unmapped_types()).collect()
    }

    /// A column of types that the mapping does not name, of the table or the table of tracks.
    fn unmapped_types(&self) -> Option<Finding> {
        const N_NAMED: usize = 8;
        let of_tracks = self.of_tracks.as_ref().map(|of_tracks| (&of_tracks.file, &of_tracks.table));
        let (file, name, texts) = [Some((&self.file, &self.table)), of_tracks]
            .into_iter()
            .flatten()
            .find_map(|(file, table)| Some((file, table.types.as_ref()?, table.text(table.types.as_deref())?)))?;
        let class = self.mapping.class.name();
        if texts.different.iter().all(|text| text.is_empty() || text.eq_ignore_ascii_case(class)) {
            return None;
        }
        let named: Vec<&str> = texts.different.iter().map(String::as_str).take(N_NAMED).collect();
        let detail = format!(
            "{file}: column {name} ({}) is not mapped, and everybody is of class {class}; name it in \
             ingest.table.columns.class, and its texts in ingest.table.classes",
            named.join(", ")
        );
        Some(Finding { what: "columns_of_types_not_mapped", n: 1, detail })
    }

    pub(super) fn groups(&self) -> Vec<Group> {
        let TableColumns { track, recording, place, .. } = &self.mapping.columns;
        let texts = |name: Option<&String>| self.table.text(name.map(String::as_str));
        let (tracks, recordings, places) = (texts(Some(track)), texts(recording.as_ref()), texts(place.as_ref()));
        let at = |texts: Option<&Texts>, row: usize| texts.map(|texts| texts.of_row[row]);
        let name = |texts: Option<&Texts>, id: Option<u32>| {
            texts.zip(id).map(|(texts, id)| texts.different[id as usize].clone())
        };
        let mut groups: Vec<Group> = Vec::new();
        let mut group_at = BTreeMap::new();
        let mut track_at = BTreeMap::new();
        for row in 0..self.table.n_rows {
            let Some(track) = at(tracks, row) else { continue };
            let key = (at(recordings, row), at(places, row));
            let group = *group_at.entry(key).or_insert_with(|| {
                let recording = name(recordings, key.0).unwrap_or_default();
                groups.push(Group { recording, place: name(places, key.1), tracks: Vec::new() });
                groups.len() - 1
            });
            let tracks = &mut groups[group].tracks;
            let index = *track_at.entry((group, track)).or_insert_with(|| {
                tracks.push((track, Vec::new()));
                tracks.len() - 1
            });
            tracks[index].1.push(row as u32);
        }
        if let Some((part, names)) = self.part.as_ref().zip(tracks) {
            let order =
                |(id, _): &(u32, Vec<u32>)| part.tracks.get(&names.different[*id as usize]).map(|track| track.number);
            groups.iter_mut().for_each(|group| group.tracks.sort_by_key(order));
        }
        groups
    }
}

impl OfTracks {
    pub(super) fn row_of(&self, id: &str) -> Result<usize, Reject> {
        self.rows
            .get(id)
            .copied()
            .ok_or_else(|| Reject { reason: "missing_track", detail: format!("{}: no row for track {id}", self.file) })
    }
}

/// The columns that a mapping names, with their kinds.
pub(super) fn wanted(columns: &TableColumns) -> Vec<(&str, Kind)> {
    let TableColumns { track, x, y, time, frame, heading, length, width, class, recording, place } = columns;
    let all = [
        (Some(track), Kind::Track),
        (Some(x), Kind::Required),
        (Some(y), Kind::Required),
        (time.as_ref(), Kind::Required),
        (frame.as_ref(), Kind::Required),
        (heading.as_ref(), Kind::Number),
        (length.as_ref(), Kind::Number),
        (width.as_ref(), Kind::Number),
        (class.as_ref(), Kind::Text),
        (recording.as_ref(), Kind::Text),
        (place.as_ref(), Kind::Text),
    ];
    let types = class.is_none().then_some(("", Kind::Types));
    let mut wanted: Vec<(&str, Kind)> = Vec::new();
    for (name, kind) in all.into_iter().filter_map(|(name, kind)| Some((name?.as_str(), kind))).chain(types) {
        // A column may have two meanings, such as place and recording.
        if !wanted.iter().any(|(found, _)| *found == name) {
            wanted.push((name, kind));
        }
    }
    wanted
}
