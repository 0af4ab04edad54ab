//! The published schemas: does `schemas/` say what the tables hold?

use djinn::store::TableSchema;
use std::collections::BTreeSet;
use std::path::PathBuf;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("schemas")
}

/// `DJINN_UPDATE_SCHEMAS=1 cargo test --test it schema` rewrites the files; a changed column needs a new version.
#[test]
fn published_schemas_are_those_of_the_tables() {
    let update = std::env::var_os("DJINN_UPDATE_SCHEMAS").is_some();
    for table in TableSchema::all() {
        let path = folder().join(format!("{}.json", table.id()));
        let expected = table.json().unwrap();
        if update {
            fs_err::write(&path, &expected).unwrap();
        }
        let found = fs_err::read_to_string(&path).unwrap_or_default();
        assert!(found == expected, "{} is out of date: set DJINN_UPDATE_SCHEMAS=1 and run again", path.display());
    }
}

#[test]
fn tables_have_distinct_names_and_columns() {
    let mut ids = BTreeSet::new();
    for table in TableSchema::all() {
        assert!(ids.insert(table.id()), "two tables are called {}", table.id());
        let mut names = BTreeSet::new();
        for field in &table.fields {
            assert!(names.insert(field.name().clone()), "{} has two columns {}", table.id(), field.name());
        }
    }
}
