//! The card of a corpus: what its users must know. It depends on the manifest alone, so that equal corpora have equal
//! cards.

use super::corpus_layout::CorpusTable;
use super::corpus_manifest::{CorpusManifest, TableEntry};
use arrow::datatypes::Field;
use std::fmt::{self, Write};

pub(crate) const CARD_FILE: &str = "README.md";

/// The card, as Markdown.
pub(crate) fn card(manifest: &CorpusManifest) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_card(&mut text, manifest);
    text
}

fn write_card(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    let CorpusManifest { n_scenarios, n_verified, n_new, n_recordings, n_maps, .. } = manifest;
    front_matter(text, manifest)?;
    writeln!(text, "# Generated traffic scenarios\n")?;
    if manifest.is_non_commercial() {
        writeln!(
            text,
            "> **Non-commercial use only.** The recordings that these scenarios were made from forbid commercial use, \
             and so it is forbidden for these scenarios, too. See [Sources and licenses](#sources-and-licenses).\n"
        )?;
    }
    writeln!(
        text,
        "{n_scenarios} generated scenarios, {n_verified} of them with the behavior that was asked for, {n_new} of \
         these where the recording does not show it. Recorded scenes that they continue: {n_recordings}; maps: \
         {n_maps}. A scenario is the joint motion of all road users near an ego: the recorded past, and a future that \
         was sampled from a learned model of traffic.\n"
    )?;
    counts(text, manifest)?;
    making(text, manifest)?;
    sources(text, manifest)?;
    text.push_str(LOADING);
    text.push_str(USE);
    tables(text, manifest)
}

/// The tables in YAML, by which `datasets.load_dataset` finds them.
fn front_matter(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    writeln!(text, "---\nlicense: other\nconfigs:")?;
    for table in CorpusTable::ALL.into_iter().filter(|table| manifest.tables.contains_key(table.name())) {
        let name = table.name();
        let files = if table.keys().is_empty() { format!("{name}.parquet") } else { format!("{name}/**/*.parquet") };
        writeln!(text, "- config_name: {name}\n  data_files: {files}")?;
        if table == CorpusTable::Scenarios {
            writeln!(text, "  default: true")?;
        }
    }
    writeln!(text, "---\n")
}

fn counts(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    writeln!(text, "## What is in it\n")?;
    writeln!(
        text,
        "| Requested behavior | Place | Scenarios | Verified | Rejected by the check | \
         New |\n|---|---|---:|---:|---:|---:|"
    )?;
    for count in &manifest.scenarios_by_partition {
        let (behavior, place) = (cell(&count.behavior), cell(&count.place));
        let (n, n_verified, n_new) = (count.n_scenarios, count.n_verified, count.n_new);
        let n_rejected = if count.behavior == super::corpus_layout::NO_BEHAVIOR { 0 } else { n - n_verified };
        writeln!(text, "| {behavior} | {place} | {n} | {n_verified} | {n_rejected} | {n_new} |")?;
    }
    writeln!(
        text,
        "\n*Verified*: the behavior's definition, the same that finds it in recordings, finds it in the scenario, with \
         the road users it was asked of. *New*: and does not find it in the recording. Where no behavior was asked for \
         (`none`), there is nothing to verify.\n"
    )?;
    for (title, counts) in [("dataset", &manifest.scenarios_by_dataset), ("sweep", &manifest.scenarios_by_sweep)] {
        let counts: Vec<String> = counts.iter().map(|(name, n)| format!("{} {n}", cell(name))).collect();
        writeln!(text, "By {title}: {}.\n", counts.join(", "))?;
    }
    Ok(())
}

fn making(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    writeln!(text, "## How it was made\n")?;
    for (name, value) in &manifest.notes {
        writeln!(text, "- {}: {}", cell(&name.replace('_', " ")), cell(value))?;
    }
    for step in &manifest.history {
        writeln!(text, "- then {}", cell(step))?;
    }
    writeln!(
        text,
        "- Every row of `scenarios` names its recorded scene, the checkpoints, the guidance, the sampler and the seed \
         it came from.\n- `manifest.json` has the size and the BLAKE3 hash of every file; `djinn corpus validate` \
         checks them and much else.\n"
    )
}

fn sources(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    writeln!(text, "## Sources and licenses\n")?;
    if manifest.sources.is_empty() {
        writeln!(text, "There are no scenarios, so there are no sources.\n")?;
    }
    for (dataset, terms) in &manifest.sources {
        writeln!(text, "- `{dataset}`: {}", cell(terms))?;
    }
    writeln!(
        text,
        "\nThe terms of a source hold for what is made from it, and for what is made from that. Keep this file with \
         copies and parts of the corpus.\n"
    )
}

const LOADING: &str = r#"## How to load it

The folder names of `scenarios`, `tracks` and `recordings` hold columns (`behavior`, `place`), which all readers below understand.
`datasets.load_dataset("path/of/the/corpus", "tracks")` reads the rows without them; in this folder,
`datasets.Dataset.from_polars(pl.read_parquet("tracks/**/*.parquet", hive_partitioning=True))` has them, too.

```sql
-- DuckDB
SELECT behavior, place, count(*) AS n, avg(verified::INT) AS verified_rate
FROM read_parquet('scenarios/**/*.parquet', hive_partitioning = true) GROUP BY ALL ORDER BY ALL;

-- generated beside recorded, state by state
SELECT t.scenario_id, t.track_id, t.t_s, t.x_m, t.y_m, r.x_m AS recorded_x_m, r.y_m AS recorded_y_m
FROM read_parquet('tracks/**/*.parquet', hive_partitioning = true) AS t
JOIN read_parquet('scenarios/**/*.parquet', hive_partitioning = true) AS s USING (scenario_id)
LEFT JOIN read_parquet('recordings/**/*.parquet', hive_partitioning = true) AS r USING (scene_id, track_id, timestep)
WHERE s.behavior = 'cut_in' AND s.verified;
```

```python
import pandas as pd

scenarios = pd.read_parquet("scenarios")
```

```python
import polars as pl
import pyarrow.dataset as ds

scenarios = pl.scan_parquet("scenarios", hive_partitioning=True)
tracks = ds.dataset("tracks", partitioning="hive").to_table(filter=ds.field("behavior") == "cut_in")
```

The states of a scenario as an array, agents by timesteps, NaN where an agent is not tracked:

```python
import numpy as np
import polars as pl

tracks = pl.read_parquet("tracks/**/*.parquet")
one = tracks.filter(pl.col("scenario_id") == tracks["scenario_id"].first())
wide = lambda column: one.pivot("timestep", index="track_id", values=column, sort_columns=True).drop("track_id")
states = np.stack([wide(column).to_numpy() for column in ("x_m", "y_m", "heading_rad")], axis=-1)
```

"#;

const USE: &str = "## What it is for, and what it is not\n\nFor testing and training driving functions against events \
that recordings hold too few of, and for research on traffic models.\n\n- Generated futures are plausible to a model; \
nobody drove them. How far their motion is from recorded motion, and how often they collide or leave the road, is \
measured: see `metrics` and the report of the run.\n- How often something happens here says nothing of how often it \
happens on roads: scenarios were asked for. `rate_per_1000_km` and `rate_per_hour` do, with an interval, where \
`rate_source` is not `none`: at the place, as recorded.\n- Scenarios of one recorded scene are not independent of each \
other: split by `scene_id`, not by scenario.\n- Traffic lights, rules and intentions that the recordings do not hold \
are not in the scenarios either.\n\n";

fn tables(text: &mut String, manifest: &CorpusManifest) -> fmt::Result {
    writeln!(text, "## Tables and columns\n\nUnits, frames and descriptions are also in the metadata of the files.\n")?;
    for table in CorpusTable::ALL {
        if let Some(entry) = manifest.tables.get(table.name()) {
            write_table(text, table, entry)?;
        }
    }
    Ok(())
}

fn write_table(text: &mut String, table: CorpusTable, entry: &TableEntry) -> fmt::Result {
    let schema = table.schema();
    let (n_rows, n_bytes, n_files) = (entry.n_rows, entry.n_bytes, entry.files.len());
    writeln!(text, "### `{}` ({})\n\n{}\n", table.name(), entry.schema, schema.description)?;
    let by = if entry.partitioned_by.is_empty() {
        String::new()
    } else {
        format!(" by {}", entry.partitioned_by.join(", "))
    };
    writeln!(text, "{n_rows} rows, {n_bytes} bytes, files{by}: {n_files}.\n")?;
    writeln!(text, "| Column | Type | Unit | Frame | |\n|---|---|---|---|---|")?;
    for field in schema.fields.iter().chain(schema.open.iter().flat_map(|open| &open.known)) {
        let of = |key: &str| field.metadata().get(key).map_or_else(String::new, |value| value.to_string());
        let plain = |value: String| if value == "none" { String::new() } else { value };
        let (unit, frame) = (plain(of("unit")), plain(of("frame")));
        writeln!(
            text,
            "| `{}` | {} | {unit} | {frame} | {} |",
            field.name(),
            type_name(field),
            cell(&of("description"))
        )?;
    }
    for open in &schema.open {
        let data_type = open.data_type.to_string().to_lowercase();
        writeln!(text, "| `{}` | {data_type} or missing | | | {} |", open.pattern, cell(open.description))?;
    }
    writeln!(text)
}

fn type_name(field: &Field) -> String {
    let missing = if field.is_nullable() { " or missing" } else { "" };
    format!("{}{missing}", super::schema::type_name(field.data_type()))
}

/// Text with escapes, so that it neither ends a table cell nor becomes markup.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace(['\n', '\r'], " ").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Dataset;
    use crate::store::PartitionCount;

    fn manifest(sources: &[(&str, &str)]) -> CorpusManifest {
        let count = PartitionCount {
            behavior: "cut_in".to_owned(),
            place: "A|B".to_owned(),
            n_scenarios: 7,
            n_verified: 5,
            n_new: 4,
        };
        CorpusManifest {
            n_scenarios: 7,
            scenarios_by_partition: vec![count],
            sources: sources.iter().map(|(name, terms)| ((*name).to_owned(), (*terms).to_owned())).collect(),
            history: vec!["filtered where gap_m < 5".to_owned()],
            ..CorpusManifest::empty()
        }
    }

    #[test]
    fn terms_are_carried_through_and_non_commercial_ones_come_first() {
        for dataset in [Dataset::Argoverse1, Dataset::Argoverse2] {
            let text = card(&manifest(&[(dataset.name(), dataset.facts().terms), ("own", "CC0")]));
            let warning = text.find("**Non-commercial use only.**").unwrap();
            assert!(warning < text.find("7 generated scenarios").unwrap());
            assert!(text.contains("CC BY-NC-SA 4.0") && text.contains("- `own`: CC0"), "{text}");
        }
        assert!(!card(&manifest(&[("own", "CC0")])).contains("Non-commercial"));
    }

    #[test]
    fn counts_and_history_are_told() {
        let text = card(&manifest(&[]));
        assert!(text.contains("| cut_in | A\\|B | 7 | 5 | 2 | 4 |"), "{text}");
        assert!(text.contains("- then filtered where gap_m &lt; 5"), "{text}");
    }
}
