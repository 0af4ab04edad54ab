//! Archives are written here with the libraries that read them, and then damaged by hand.

use super::*;
use flate2::{Compression, write::GzEncoder};
use std::io::Write;

type Seen = Vec<(String, Result<String, String>)>;

/// Every wanted entry with its content, or the message of the failed read.
fn visit_all(inputs: &[PathBuf], wanted: &dyn Fn(&str) -> bool) -> (Seen, Result<(), Error>) {
    let mut seen = Vec::new();
    let result = visit_entries(inputs, wanted, &mut |entry, reader| {
        let mut text = String::new();
        let content = reader.read_to_string(&mut text).map(|_| text).map_err(|error| error.to_string());
        seen.push((entry.path.clone(), content));
        Ok(ControlFlow::Continue(()))
    });
    (seen, result)
}

fn texts(input: &Path) -> Vec<(String, String)> {
    let (seen, result) = visit_all(&[input.to_owned()], &|_| true);
    result.unwrap();
    seen.into_iter().map(|(path, text)| (path, text.unwrap())).collect()
}

fn expected(entries: &[(&str, &str)]) -> Vec<(String, String)> {
    entries.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect()
}

fn gz(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn tar_of(entries: &[(&str, &str)]) -> Vec<u8> {
    let mut builder = tar::Builder::new(Vec::new());
    for (path, text) in entries {
        let mut header = tar::Header::new_gnu();
        header.set_size(text.len() as u64);
        builder.append_data(&mut header, path, text.as_bytes()).unwrap();
    }
    builder.into_inner().unwrap()
}

fn zip_of(entries: &[(&str, &str)]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(io::Cursor::new(Vec::new()));
    for (path, text) in entries {
        let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        writer.start_file(*path, stored).unwrap();
        writer.write_all(text.as_bytes()).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Writes the files into a new folder.
fn folder_of(files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs_err::create_dir_all(path.parent().unwrap()).unwrap();
        fs_err::write(path, bytes).unwrap();
    }
    folder
}

#[test]
fn a_folder_is_read_by_name_and_archives_in_it_are_entered() {
    let folder = folder_of(&[
        ("val/b.csv", b"b"),
        ("val/a.csv.gz", &gz(b"a")),
        ("train.zip", &zip_of(&[("z.csv", "z"), ("y.csv", "y"), ("__MACOSX/._z.csv", "no")])),
        ("extra.tar", &tar_of(&[("t.csv", "t")])),
        ("extra2.tar.gz", &gz(&tar_of(&[("u/u.csv", "u")]))),
        ("extra3.tgz", &gz(&tar_of(&[("v.csv", "v")]))),
        (".hidden/c.csv", b"no"),
    ]);
    let all = [("t.csv", "t"), ("u/u.csv", "u"), ("v.csv", "v"), ("z.csv", "z"), ("y.csv", "y")];
    let all = [&all[..], &[("val/a.csv", "a"), ("val/b.csv", "b")]].concat();
    assert_eq!(texts(folder.path()), expected(&all));
    assert_eq!(texts(&folder.path().join("val/b.csv")), expected(&[("b.csv", "b")]));
    assert_eq!(texts(&folder.path().join("val/a.csv.gz")), expected(&[("a.csv", "a")]));
}

#[test]
fn only_wanted_entries_are_visited_and_a_break_ends_the_visit() {
    let folder = folder_of(&[("a.zip", &zip_of(&[("1.csv", "1"), ("2.txt", "2"), ("3.csv", "3")])), ("b.csv", b"4")]);
    let (seen, result) = visit_all(&[folder.path().to_owned()], &|path| path.ends_with(".csv"));
    result.unwrap();
    assert_eq!(seen.iter().map(|(path, _)| path.as_str()).collect::<Vec<_>>(), ["1.csv", "3.csv", "b.csv"]);

    let mut n_visits = 0;
    visit_entries(&[folder.path().to_owned()], &|_| true, &mut |_, _| {
        n_visits += 1;
        Ok(ControlFlow::Break(()))
    })
    .unwrap();
    assert_eq!(n_visits, 1);
}

#[test]
fn hostile_names_are_only_names() {
    let folder = folder_of(&[("a.zip", &zip_of(&[("../../etc/passwd", "1"), ("/abs\\x\u{1b}.csv", "2")]))]);
    assert_eq!(texts(folder.path()), expected(&[("etc/passwd", "1"), ("abs/x\u{fffd}.csv", "2")]));
}

#[test]
fn long_names_in_tar_archives_are_whole_and_bounded() {
    let long = format!("{}/x.csv", ["folder"; 30].join("/"));
    let folder = folder_of(&[("a.tar", &tar_of(&[(&long, "1"), ("short.csv", "2")]))]);
    assert_eq!(texts(folder.path()), expected(&[(&long, "1"), ("short.csv", "2")]));

    let too_long = "n/".repeat(100_000);
    let folder = folder_of(&[("a.tar", &tar_of(&[(&too_long, "1")]))]);
    let (_, result) = visit_all(&[folder.path().join("a.tar")], &|_| true);
    let message = result.unwrap_err().to_string();
    assert!(message.contains("a.tar") && message.contains("longer than"), "{message}");
}

#[test]
fn pax_names_are_read() {
    let mut builder = tar::Builder::new(Vec::new());
    builder.append_pax_extensions([("path", &b"train/data/1.csv"[..])]).unwrap();
    let mut header = tar::Header::new_ustar();
    header.set_size(1);
    builder.append_data(&mut header, "cut-short", &b"1"[..]).unwrap();
    let folder = folder_of(&[("a.tar", &builder.into_inner().unwrap())]);
    assert_eq!(texts(folder.path()), expected(&[("train/data/1.csv", "1")]));
}

#[test]
fn a_damaged_zip_entry_does_not_hide_the_others() {
    let mut bytes = zip_of(&[("a.csv", "first"), ("b.csv", "second"), ("c.csv", "third")]);
    let at = bytes.windows(6).position(|window| window == b"second").unwrap();
    bytes[at] ^= 0xff;
    let folder = folder_of(&[("a.zip", &bytes)]);
    let (seen, result) = visit_all(&[folder.path().to_owned()], &|_| true);
    result.unwrap();
    assert_eq!(seen[0].1.as_deref(), Ok("first"));
    assert!(seen[1].1.is_err());
    assert_eq!(seen[2].1.as_deref(), Ok("third"));

    // A broken header in front of an entry is the entry's fault too.
    let mut bytes = zip_of(&[("a.csv", "first"), ("b.csv", "second")]);
    bytes[0] = 0;
    let folder = folder_of(&[("a.zip", &bytes)]);
    let (seen, result) = visit_all(&[folder.path().to_owned()], &|_| true);
    result.unwrap();
    assert!(seen[0].1.is_err());
    assert_eq!(seen[1].1.as_deref(), Ok("second"));
}

#[test]
fn containers_that_are_cut_short_are_errors_that_name_them() {
    let long_text = "0123456789".repeat(20_000);
    let entries = [("a.csv", "first"), ("b.csv", long_text.as_str())];
    let tar = tar_of(&entries);
    let tar_gz = gz(&tar);
    for (name, bytes, n_whole_entries) in [
        ("a.zip", zip_of(&entries)[..5000].to_vec(), 0),
        ("a.tar", tar[..5000].to_vec(), 1),
        ("a.tar.gz", tar_gz[..tar_gz.len() / 2].to_vec(), 1),
    ] {
        let folder = folder_of(&[(name, &bytes)]);
        let (seen, result) = visit_all(&[folder.path().join(name)], &|_| true);
        let message = result.unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
        assert_eq!(seen.iter().filter(|(_, text)| text.is_ok()).count(), n_whole_entries, "{name}: {seen:?}");
    }
    let text_gz = gz(long_text.as_bytes());
    let folder = folder_of(&[("a.csv.gz", &text_gz[..text_gz.len() - 20])]);
    let (seen, result) = visit_all(&[folder.path().to_owned()], &|_| true);
    result.unwrap();
    assert!(format!("{:?}", seen[0].1).contains("download it again"), "{seen:?}");
}

#[test]
fn the_end_of_an_archive_is_checked() {
    let tar = tar_of(&[("a.csv", "first"), ("b.csv", "second")]);
    let mut wrong_checksum = gz(&tar);
    let at = wrong_checksum.len() - 8;
    wrong_checksum[at] ^= 1;
    // Bytes after the mark, or after the compressed stream, do not belong to the archive.
    for (name, bytes) in [
        ("a.tar", [&tar[..], b"signed"].concat()),
        ("a.tar.gz", [gz(&tar), vec![0; 600]].concat()),
        ("a.tar.gz", [gz(&tar), b"signed by somebody".to_vec()].concat()),
    ] {
        let folder = folder_of(&[(name, &bytes)]);
        assert_eq!(texts(folder.path()).len(), 2);
    }
    for (name, bytes, n_seen) in [
        // Between two entries, where no part of a file is missing.
        ("a.tar", tar[..1024].to_vec(), 1),
        ("a.tar", Vec::new(), 0),
        ("a.tar.gz", wrong_checksum, 2),
    ] {
        let folder = folder_of(&[(name, &bytes)]);
        let (seen, result) = visit_all(&[folder.path().join(name)], &|_| true);
        assert_eq!(seen.len(), n_seen);
        let message = result.unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("truncated"), "{message}");
    }
}

#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_opened_fails_when_it_is_read() {
    let folder = folder_of(&[("a.csv", b"1"), ("c.csv", b"3")]);
    for name in ["b.csv", "b.csv.gz"] {
        std::os::unix::fs::symlink("nowhere", folder.path().join(name)).unwrap();
        let (seen, result) = visit_all(&[folder.path().to_owned()], &|_| true);
        result.unwrap();
        let found = seen.iter().map(|(path, text)| (path.as_str(), text.is_ok())).collect::<Vec<_>>();
        assert_eq!(found, [("a.csv", true), ("b.csv", false), ("c.csv", true)]);
        fs_err::remove_file(folder.path().join(name)).unwrap();
    }
}

#[test]
fn a_missing_input_is_named() {
    let (_, result) = visit_all(&["no/such/folder".into()], &|_| true);
    assert!(result.unwrap_err().to_string().contains("no/such/folder"));
}

#[cfg(unix)]
#[test]
fn links_in_a_circle_are_not_followed() {
    let folder = folder_of(&[("a/b.csv", b"1")]);
    std::os::unix::fs::symlink(folder.path(), folder.path().join("a/up")).unwrap();
    let (seen, result) = visit_all(&[folder.path().to_owned()], &|_| true);
    result.unwrap();
    assert_eq!(seen, [("a/b.csv".to_owned(), Ok("1".to_owned()))]);
}

#[test]
fn an_archive_of_something_else_does_not_hinder_the_folder() {
    let zip = zip_of(&[("a.csv", "1")]);
    let folder = folder_of(&[("broken.zip", &zip[..20]), ("z.csv", b"2"), ("cut.tar.gz", &gz(b"no archive")[..12])]);
    let asked = std::cell::RefCell::new(Vec::new());
    let wanted = |path: &str| {
        asked.borrow_mut().push(path.to_owned());
        path.ends_with(".csv")
    };
    let (seen, result) = visit_all(&[folder.path().to_owned()], &wanted);
    result.unwrap();
    assert_eq!(seen, [("z.csv".to_owned(), Ok("2".to_owned()))]);
    assert_eq!(asked.into_inner(), ["broken.zip", "cut.tar.gz", "z.csv"], "they are files like any other");
    // An archive that is an input itself is always wanted.
    assert!(visit_all(&[folder.path().join("broken.zip")], &|_| true).1.is_err());
}
