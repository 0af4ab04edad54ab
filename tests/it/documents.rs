//! Do the documents speak of what exists? Configurations in them are parsed, files and options they name must be there.

use crate::support::read;
use djinn::pipeline::config::parse;
use djinn::store::TableSchema;

/// The fenced blocks of `language` in a document.
fn blocks(document: &str, language: &str) -> Vec<String> {
    let fence = format!("```{language}\n");
    document.split(&fence).skip(1).map(|rest| rest.split("```").next().unwrap_or_default().to_owned()).collect()
}

/// The pages that people read first.
const PAGES: [&str; 6] = [
    "README.md",
    "pipelines/README.md",
    "pipelines/CLUSTER.md",
    "pipelines/DRIVE.md",
    "configs/README.md",
    "schemas/README.md",
];

fn blocks_of_pages(language: &str) -> Vec<String> {
    let found: Vec<String> = PAGES.iter().flat_map(|page| blocks(&read(page), language)).collect();
    assert!(!found.is_empty(), "no {language} on {PAGES:?}");
    found
}

#[test]
fn configurations_on_the_pages_are_valid() {
    for block in blocks_of_pages("toml") {
        if let Err(error) = parse(None, &block, &[]) {
            panic!("{error}\n{block}");
        }
    }
}

#[test]
fn columns_in_the_example_queries_exist() {
    let schemas = TableSchema::all();
    let columns = |table: &str| -> Vec<String> {
        let schema = schemas.iter().find(|schema| schema.name == table).unwrap();
        schema.fields.iter().map(|field| field.name().clone()).collect()
    };
    // Parameters of events are columns too, where events have them.
    let parameters = ["gap_m", "min_distance_m", "relative_speed_mps"].map(str::to_owned);
    let known: Vec<String> =
        [columns("scenario"), columns("track"), columns("recording"), columns("coverage"), parameters.to_vec()]
            .concat();
    let keywords = ["read_parquet", "hive_partitioning", "speed_mps", "deviation_m"];
    for query in blocks_of_pages("sql") {
        let code: String = query.lines().filter(|line| !line.starts_with("--")).collect::<Vec<_>>().join("\n");
        let unquoted: String = code.split('\'').step_by(2).collect::<Vec<_>>().join(" ");
        for word in unquoted.split(|c: char| !(c.is_alphanumeric() || c == '_')) {
            let is_name = word.contains('_') && word.chars().all(|c| c.is_lowercase() || c.is_numeric() || c == '_');
            assert!(!is_name || keywords.contains(&word) || known.contains(&word.to_owned()), "no column {word}");
        }
    }
    // In Python, columns are texts; folders' columns have names of their own.
    for block in blocks_of_pages("python") {
        for word in block.split('"').skip(1).step_by(2) {
            let is_name = word.contains('_') && word.chars().all(|c| c.is_lowercase() || c.is_numeric() || c == '_');
            let is_value = ["cut_in", "verified_rate"].contains(&word);
            assert!(!is_name || is_value || known.contains(&word.to_owned()), "no column {word}");
        }
    }
}
