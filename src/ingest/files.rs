//! The split in a file's name, and its bytes.

use super::archive::Entry;
use super::raw::Reject;
use crate::scene::Split;
use std::io::{BufRead, Read};
use std::path::Path;

/// Maximum size of a recording or map that is read as a whole; a larger file is not one.
pub(super) const MAX_WHOLE_FILE_BYTES: u64 = 64 << 20;

/// The name of a file without its folders.
pub(super) fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// The name of a file without its folders and last extension.
pub(super) fn file_stem(path: &str) -> &str {
    let name = file_name(path);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Whether a file is an archive by its name. Supported archives are entered; one that arrives as a file is of another
/// kind, within an archive, or damaged.
pub(super) fn is_archive(path: &str) -> bool {
    const ARCHIVES: [&str; 12] =
        [".zip", ".tar", ".tar.gz", ".tgz", ".7z", ".rar", ".xz", ".txz", ".bz2", ".tbz2", ".zst", ".lz4"];
    let lower = path.to_ascii_lowercase();
    let part = lower.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('.');
    ARCHIVES.iter().any(|suffix| lower.ends_with(suffix) || part.ends_with(suffix))
}

/// The reject for an archive that arrives as a file: its content is not read.
pub(super) fn passed_over(path: &str, reader: &mut dyn BufRead) -> Reject {
    let why = reader.fill_buf().map_or_else(
        |error| error.to_string(),
        |_| {
            let kinds = "of a kind that is not read (.zip, .tar, .tar.gz and .tgz are)";
            format!("it is within another archive, or {kinds}; unpack it if it is needed")
        },
    );
    Reject { reason: "archive_passed_over", detail: format!("{path}: {why}") }
}

/// Whether a file has the name that a browser or a file manager gives to a copy: `x (1).csv`, `x - Copy.csv`.
pub(super) fn is_copy(path: &str) -> bool {
    let stem = file_name(path).split('.').next().unwrap_or_default();
    let numbered = stem.strip_suffix(')').and_then(|stem| stem.rsplit_once(" ("));
    let is_numbered = numbered.is_some_and(|(_, n)| !n.is_empty() && n.bytes().all(|byte| byte.is_ascii_digit()));
    is_numbered || stem.to_ascii_lowercase().ends_with(" copy")
}

/// The split that the folders of `path` name, the innermost first.
pub(super) fn split_of_path(path: &str) -> Option<Split> {
    path.rsplit('/').find_map(split_of_name)
}

/// The split that the folders of an entry name, or otherwise its container or the folder around that.
pub(super) fn split_of_entry(entry: &Entry) -> Split {
    let name_of = |path: &Path| path.file_name().and_then(|name| split_of_name(&name.to_string_lossy()));
    split_of_path(&entry.path)
        .or_else(|| name_of(&entry.container))
        .or_else(|| entry.container.parent().and_then(name_of))
        .unwrap_or(Split::Unsplit)
}

/// The split that a folder is called for. A name that only has such a word in it may be that of a recording.
fn split_of_name(name: &str) -> Option<Split> {
    match name.to_ascii_lowercase().as_str() {
        "train" | "training" => Some(Split::Train),
        "val" | "validation" => Some(Split::Val),
        // Argoverse 1 calls its test sequences, which end at the present, so.
        "test" | "testing" | "test_obs" => Some(Split::Test),
        _ => None,
    }
}

/// The bytes of an entry. An entry that cannot be read or is too large is a reject: one broken file among many.
pub(super) fn read_at_most(entry: &Entry, reader: &mut dyn BufRead, max_bytes: u64) -> Result<Vec<u8>, Reject> {
    let mut bytes = Vec::with_capacity(entry.size.unwrap_or(0).min(max_bytes) as usize);
    let reject = |reason, detail| Reject { reason, detail: format!("{}: {detail}", entry.path) };
    match reader.take(max_bytes + 1).read_to_end(&mut bytes) {
        Err(error) => Err(reject("unreadable", error.to_string())),
        Ok(_) if bytes.len() as u64 > max_bytes => {
            Err(reject("too_large", format!("more than {} MiB", max_bytes >> 20)))
        }
        Ok(_) => Ok(bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(container: &str, path: &str) -> Entry {
        Entry { path: path.to_owned(), container: container.into(), size: None }
    }

    #[test]
    fn splits_come_from_the_innermost_name_that_tells() {
        for (container, path, split) in [
            ("forecasting_train_v1.1.tar.gz", "val/data/3.csv", Split::Val),
            ("scenarios/A_train.tar", "A_train.xml", Split::Unsplit),
            ("/data/forecasting/val/data", "3.csv", Split::Val),
            ("/data/train/a.zip", "b/3.csv", Split::Train),
            ("a.zip", "Test_obs/data/3.csv", Split::Test),
            ("/data", "val_2024/3.csv", Split::Unsplit),
            ("/home/training_course/a/b", "data/3.csv", Split::Unsplit),
            ("/data/tests/valley", "trainer/3.csv", Split::Unsplit),
        ] {
            assert_eq!(split_of_entry(&entry(container, path)), split, "{container} {path}");
        }
    }

    #[test]
    fn names_without_folders_and_extension() {
        assert_eq!(file_stem("a.b/c.d.csv"), "c.d");
        assert_eq!(file_stem("plain"), "plain");
    }

    #[test]
    fn archives_are_told_by_name() {
        for archive in ["x/inner.zip", "a.tar.xz", "b.zip.001", "c.7Z"] {
            assert!(is_archive(archive), "{archive}");
        }
        for file in ["a.csv", "zip.csv", "b.osm_xy", "x.zip/a.csv"] {
            assert!(!is_archive(file), "{file}");
        }
    }

    #[test]
    fn copies_are_told_by_name() {
        for copy in ["A/vehicle_tracks_000 (1).csv", "1 (12).csv", "a - Copy.csv", "a copy.tar.gz", "a - Copy (2).csv"]
        {
            assert!(is_copy(copy), "{copy}");
        }
        for name in ["A (1)/vehicle_tracks_000.csv", "a (b).csv", "a().csv", "copy.csv", "hardcopy.csv", "a(1).csv"] {
            assert!(!is_copy(name), "{name}");
        }
    }

    #[test]
    fn endless_files_are_rejects() {
        let mut endless = std::io::BufReader::new(std::io::repeat(b'1'));
        let found = read_at_most(&entry("x", "y.csv"), &mut endless, MAX_WHOLE_FILE_BYTES).unwrap_err().reason;
        assert_eq!(found, "too_large");
    }
}
