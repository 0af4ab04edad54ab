//! Does the code keep the rules that ARCHITECTURE.md states? The tables there are read here: they are the rules.

use crate::support::{files_below, read, root};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const MAX_LINES: usize = 600;
/// `max_width` of `rustfmt.toml`, which leaves comments and literals as they are.
const MAX_WIDTH: usize = 120;

/// A source file without its tests and comments.
struct Source {
    path: PathBuf,
    /// The module path, such as `["report", "svg", "axes"]`.
    module: Vec<String>,
    text: String,
    code: String,
}

fn rust_files(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    files_below(&root().join(folder), "rs", &mut found);
    found
}

/// Every file of the library that is not a test.
fn sources() -> Vec<Source> {
    let src = root().join("src");
    let mut sources = Vec::new();
    for path in rust_files("src") {
        let relative = path.strip_prefix(&src).unwrap().with_extension("");
        let mut module: Vec<String> = relative.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        let is_test = |part: &String| part.starts_with("test") || part.ends_with("_test") || part.ends_with("_tests");
        if module.iter().any(is_test) {
            continue;
        }
        if module.last().is_some_and(|last| last == "mod") {
            module.pop();
        }
        let text = fs_err::read_to_string(&path).unwrap();
        let code = without_tests_and_comments(&text);
        sources.push(Source { path, module, text, code });
    }
    sources
}

/// Drops line comments, and everything from the test module on, which by convention is last.
fn without_tests_and_comments(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    text[..end].lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// The rows of the table in `document` whose header starts with `first_column`; cells are lists of `code` words.
fn table(document: &str, first_column: &str) -> Vec<Vec<Vec<String>>> {
    let header = format!("| {first_column} |");
    let rows =
        document.lines().skip_while(|line| !line.starts_with(&header)).skip(2).take_while(|line| line.starts_with('|'));
    let words = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    rows.map(|row| row.trim_matches('|').split('|').map(words).collect()).collect()
}

/// Rank by module: modules in the same row share a rank, later rows rank higher.
fn ranks() -> BTreeMap<String, usize> {
    let rows = table(&read("ARCHITECTURE.md"), "Rank");
    assert!(!rows.is_empty(), "ARCHITECTURE.md has no table of ranks");
    rows.iter().enumerate().flat_map(|(rank, row)| row[1].iter().map(move |module| (module.clone(), rank))).collect()
}

/// The modules of this crate that `code` names after `crate::`, braces included.
fn modules_named(code: &str) -> Vec<String> {
    let mut named = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        if code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        let Some(group) = rest.strip_prefix('{') else {
            named.push(identifier(rest));
            continue;
        };
        let mut depth = 0;
        let mut items = vec![String::new()];
        for c in group.chars() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => items.push(String::new()),
                _ if depth == 0 => items.last_mut().unwrap().push(c),
                _ => {}
            }
        }
        named.extend(items.iter().map(|item| identifier(item.trim())).filter(|name| !name.is_empty()));
    }
    named
}

/// Drops the content of raw strings, which cannot be broken, but for its ends of lines.
fn without_raw_strings(text: &str) -> String {
    let (mut kept, mut rest) = (String::new(), text);
    while let Some(start) = rest.find("r#\"") {
        let (before, raw) = rest.split_at(start + "r#\"".len());
        let end = raw.find("\"#").unwrap_or(raw.len());
        kept.push_str(before);
        kept.extend(raw[..end].chars().filter(|c| *c == '\n'));
        rest = &raw[end..];
    }
    kept + rest
}

fn identifier(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// Whether `code` names the crate `name`, in a path or an import.
fn names_crate(code: &str, name: &str) -> bool {
    code.match_indices(name).any(|(at, _)| {
        let before = code[..at].chars().next_back();
        let after = &code[at + name.len()..];
        !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':' || c == '.' || c == '"')
            && (after.starts_with("::") || (after.starts_with(';') && code[..at].ends_with("use ")))
    })
}

#[test]
fn modules_use_only_modules_of_lower_rank() {
    let ranks = ranks();
    let mut faults = Vec::new();
    for source in sources() {
        let Some(module) = source.module.first().filter(|first| !["lib", "main"].contains(&first.as_str())) else {
            continue;
        };
        let Some(rank) = ranks.get(module) else { panic!("`{module}` has no rank in ARCHITECTURE.md") };
        for used in modules_named(&source.code) {
            let allowed = used == *module || ranks.get(&used).is_some_and(|used_rank| used_rank < rank);
            if !allowed {
                faults.push(format!("{}: {module} may not use crate::{used}", source.path.display()));
            }
        }
        // A chain of supers must not leave the module by the roof.
        let climb = "super::".repeat(source.module.len());
        if source.code.contains(&climb) {
            faults.push(format!("{}: `{climb}` reaches the crate's root; write `crate::`", source.path.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn tensors_and_noise_know_nothing_of_scenes() {
    for source in sources().iter().filter(|s| s.module.first().is_some_and(|m| m == "nn" || m == "diffusion")) {
        assert!(!modules_named(&source.code).contains(&"scene".to_owned()), "{} names scenes", source.path.display());
    }
}

/// A difference between datasets is a fact of the table in `scene::dataset`, or a format in the dataset's own folder:
/// code that asks for a dataset by its name is silently wrong about the next one.
#[test]
fn datasets_are_told_apart_in_their_table_and_their_readers_alone() {
    let table = sources().into_iter().find(|source| source.module == ["scene", "dataset"]).unwrap();
    let listed = table.code.split("pub enum Dataset {").nth(1).unwrap().split('}').next().unwrap();
    let variants: Vec<String> = listed.lines().map(|line| identifier(line.trim())).filter(|v| !v.is_empty()).collect();
    assert!(variants.len() >= 3, "{variants:?}");
    let mut faults = Vec::new();
    for source in sources().iter().filter(|source| source.module.first().is_some_and(|module| module != "ingest")) {
        for (at, matched) in source.code.match_indices("Dataset::") {
            let named = identifier(&source.code[at + matched.len()..]);
            if variants.contains(&named) {
                faults.push(format!("{}: ask Dataset::facts instead of for Dataset::{named}", source.path.display()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn crates_are_named_only_where_the_table_allows() {
    let rows = table(&read("ARCHITECTURE.md"), "Crate");
    assert!(!rows.is_empty(), "ARCHITECTURE.md has no table of crates");
    let mut faults = Vec::new();
    for source in sources() {
        let Some(module) = source.module.first() else { continue };
        for row in &rows {
            let (crates, allowed) = (&row[0], &row[1]);
            for name in crates.iter().filter(|name| names_crate(&source.code, name)) {
                if !allowed.contains(module) {
                    faults.push(format!("{}: {module} may not name {name}", source.path.display()));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn files_say_what_they_answer_and_stay_small() {
    let mut faults = Vec::new();
    for path in rust_files("src").into_iter().chain(rust_files("tests")) {
        let text = fs_err::read_to_string(&path).unwrap();
        if !text.starts_with("//! ") {
            faults.push(format!("{} does not begin with a `//!` line", path.display()));
        }
        let n_lines = text.lines().count();
        if n_lines > MAX_LINES {
            faults.push(format!("{} has {n_lines} lines, more than {MAX_LINES}", path.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn lines_fit_the_width() {
    let mut faults = Vec::new();
    for path in rust_files("src").into_iter().chain(rust_files("tests")) {
        let text = fs_err::read_to_string(&path).unwrap();
        for (idx, line) in without_raw_strings(&text).lines().enumerate() {
            let width = line.chars().count();
            if width > MAX_WIDTH {
                faults.push(format!("{}:{} has {width} columns, more than {MAX_WIDTH}", path.display(), idx + 1));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn nothing_is_left_for_later() {
    // Put together at run time so that this file passes its own test.
    let forbidden = [["todo", "!("], ["unimplemented", "!("], ["#[ign", "ore"], ["#[al", "low("], ["#![al", "low("]];
    let mut faults = Vec::new();
    for path in rust_files("src").into_iter().chain(rust_files("tests")) {
        let text = fs_err::read_to_string(&path).unwrap();
        for parts in forbidden {
            let word = parts.concat();
            if text.contains(&word) {
                faults.push(format!("{} contains `{word}`", path.display()));
            }
        }
        if text.to_lowercase().lines().any(|line| line.contains(concat!("//", "! placeholder"))) {
            faults.push(format!("{} is a placeholder", path.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_code_map_names_every_module_and_only_those() {
    let document = read("ARCHITECTURE.md");
    let library = sources().into_iter().find(|source| source.module == ["lib"]).unwrap();
    let modules: Vec<String> =
        library.text.lines().filter_map(|line| line.strip_prefix("pub mod ")).map(identifier).collect();
    let mut ranked: Vec<String> = ranks().into_keys().collect();
    let mut declared = modules.clone();
    ranked.sort();
    declared.sort();
    assert_eq!(ranked, declared, "the table of ranks and lib.rs list different modules");
    for module in modules {
        assert!(document.contains(&format!("\n## `{module}`")), "ARCHITECTURE.md has no section on `{module}`");
    }
}

#[test]
fn links_in_the_documents_lead_somewhere() {
    let top = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "GLOSSARY.md"];
    let below = [
        "configs/README.md",
        "pipelines/README.md",
        "pipelines/CLUSTER.md",
        "pipelines/models/README.md",
        "schemas/README.md",
    ];
    for name in top.into_iter().chain(below) {
        let (text, folder) = (read(name), Path::new(name).parent().unwrap());
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split(')').next().unwrap();
            if target.contains("://") {
                continue;
            }
            let file = target.split('#').next().unwrap();
            assert!(
                file.is_empty() || root().join(folder).join(file).exists(),
                "{name} links to {file}, which does not exist"
            );
        }
    }
}

#[test]
fn the_scanner_sees_through_groups_strings_and_comments() {
    let code = without_tests_and_comments(
        "use crate::{geometry::{Vec2, Polyline}, scene::Scene};\n// crate::cli\nfn f() { crate::nn::g() }\n\
         #[cfg(test)]\nmod tests {\n use crate::cli;\n}\n",
    );
    assert_eq!(modules_named(&code), ["geometry", "scene", "nn"]);
    assert!(names_crate("use polars::prelude::*;", "polars") && names_crate("fn f() -> csv::Result<()>", "csv"));
    assert!(!names_crate("use my_csv::X;", "csv") && !names_crate("use crate::ingest::csv::X;", "csv"));
    assert_eq!(without_raw_strings("a(r#\"b\nc\"#, d)"), "a(r#\"\n\"#, d)");
}
