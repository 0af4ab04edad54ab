//! Are foreign files left alone, and are our own recognized?

use super::*;
use fs_err as fs;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

fn write(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_atomically::<io::Error>(path, |file| file.write_all(text.as_bytes())).unwrap();
}

fn put(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn names_of(names: &[&str]) -> BTreeSet<PathBuf> {
    names.iter().map(PathBuf::from).collect()
}

#[test]
fn two_writers_of_one_file_do_not_share_a_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.txt");
    let (mut one, mut two) = (AtomicFile::create(&path).unwrap(), AtomicFile::create(&path).unwrap());
    for (file, text) in [(&mut one, "one"), (&mut two, "second")] {
        file.write_all(text.as_bytes()).unwrap();
    }
    two.commit().unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "second");
    one.commit().unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "one");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn partial_names_are_told_from_names_of_others() {
    let partial = unique_partial(Path::new("x/a.txt"));
    let name = partial.file_name().unwrap().to_str().unwrap();
    assert!(partial.parent() == Some(Path::new("x")) && is_partial_of(name, "a.txt"), "{name}");
    for (name, whole) in [("a.txt.partial", "a.txt"), ("a.txt.0123456789abcdeg.partial", "a.txt"), (name, "b.txt")] {
        assert!(!is_partial_of(name, whole), "{name}");
    }
}

#[test]
fn the_innermost_list_names_every_file_that_was_begun() {
    let dir = tempfile::tempdir().unwrap();
    let inner = dir.path().join("inner");
    write(&dir.path().join("before.txt"), "");
    fs::create_dir(&inner).unwrap();
    keep_list(dir.path()).unwrap();
    keep_list(&inner).unwrap();
    write(&dir.path().join("folder/a.txt"), "a");
    write(&inner.join("line\nbreak.txt"), "b");
    drop(AtomicFile::create(&dir.path().join("given up.txt")).unwrap());
    assert_eq!(foreign(dir.path(), &BTreeSet::new()).unwrap().len(), 4, "nothing is left of it");
    assert_eq!(listed(dir.path()).unwrap(), Some(names_of(&["folder/a.txt", "given up.txt"])));
    assert_eq!(listed(&inner).unwrap(), Some(names_of(&["line\nbreak.txt"])));
    assert_eq!(listed(&dir.path().join("folder")).unwrap(), None);
}

#[test]
fn a_list_may_be_cut_off_and_every_flipped_bit_of_it_is_noticed() {
    let dir = tempfile::tempdir().unwrap();
    keep_list(dir.path()).unwrap();
    write(&dir.path().join("a"), "");
    write(&dir.path().join("x/b"), "");
    let path = dir.path().join(LIST_FILE);
    let list = fs::read(&path).unwrap();
    for bit in 0..8 * list.len() {
        let mut flipped = list.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        fs::write(&path, flipped).unwrap();
        let said = listed(dir.path()).unwrap_err().to_string();
        assert!(said.contains(".djinn-written is damaged: line ") && said.contains("nothing was changed"), "{said}");
    }
    let n_first = list.iter().position(|byte| *byte == b'\n').unwrap() + 1;
    for n_bytes in n_first..list.len() {
        fs::write(&path, &list[..n_bytes]).unwrap();
        assert!(listed(dir.path()).unwrap().is_some_and(|names| names == names_of(&["a"])), "{n_bytes} bytes");
    }
    // The next writer ends the line first.
    remove_leftovers(dir.path()).unwrap();
    write(&dir.path().join("c"), "");
    assert_eq!(listed(dir.path()).unwrap(), Some(names_of(&["a", "c"])));
}

#[cfg(target_os = "linux")]
#[test]
fn folders_are_exchanged_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| dir.path().join(name));
    put(&a.join("old"), "");
    put(&b.join("new"), "");
    assert!(exchange(&a, &b).unwrap() && a.join("new").exists() && b.join("old").exists());
}

#[test]
fn a_list_that_leads_elsewhere_is_damaged() {
    for name in ["../thesis.doc", "/etc/passwd", "", ".", "a/../../b", "a//b", "a/./b", "a/", "nul\0"] {
        assert!(!stays_below(name), "{name:?}");
        let dir = tempfile::tempdir().unwrap();
        keep_list(dir.path()).unwrap();
        enter_all(dir.path(), [Path::new(name)].into_iter()).unwrap();
        assert!(matches!(listed(dir.path()), Err(Error::Damaged { .. })), "{name:?}");
    }
    assert!(["a", "a/b.c/..d", "...", "a b", "\u{e4}", "line\nbreak"].into_iter().all(stays_below));
}

#[cfg(unix)]
#[test]
fn nothing_is_removed_through_a_link() {
    let dir = tempfile::tempdir().unwrap();
    let (theirs, link) = (dir.path().join("theirs"), dir.path().join("link"));
    put(&theirs.join("a"), "years of work");
    keep_list(&theirs).unwrap();
    enter_all(&theirs, [Path::new("a")].into_iter()).unwrap();
    std::os::unix::fs::symlink("theirs", &link).unwrap();
    let all = names_of(&["a"]);
    assert!(matches!(remove_listed(&link, &all), Err(Error::Link { .. })));
    assert!(matches!(remove_leftovers(&link), Err(Error::Link { .. })));
    assert!(matches!(clear(&link), Err(Error::Link { .. })));
    assert_eq!(files_below(&theirs).unwrap().len(), 2);
}

#[test]
fn only_what_the_list_names_is_removed() {
    let dir = tempfile::tempdir().unwrap();
    let work = dir.path().join("work");
    fs::create_dir(&work).unwrap();
    keep_list(&work).unwrap();
    write(&work.join("corpus/x/a.parquet"), "ours");
    write(&work.join("corpus/y/b.parquet"), "ours");
    let mut half = AtomicFile::create(&work.join("corpus/y/c.parquet")).unwrap();
    half.write_all(b"half").unwrap();
    std::mem::forget(half);
    put(&work.join("corpus/y/thesis.doc"), "theirs");
    put(&work.join("corpus/y/c.parquet.partial"), "theirs");
    // Half of a file that is not ours, and one that begins and ends as half of ours does.
    let half = unique_partial(Path::new("corpus/y/thesis.doc"));
    put(&work.join(&half), "theirs");
    put(&work.join("corpus/y/c.parquet.my.partial"), "theirs");
    let half = half.to_str().unwrap();
    let theirs =
        names_of(&["corpus/y/c.parquet.my.partial", "corpus/y/c.parquet.partial", "corpus/y/thesis.doc", half]);
    let ours = listed(&work).unwrap().unwrap();
    assert_eq!(foreign(&work, &ours).unwrap(), theirs.iter().cloned().collect::<Vec<_>>());
    assert!(matches!(clear(&work.join("corpus")), Err(Error::Foreign { found, .. }) if found.len() == 4));
    clear(&work.join("corpus/x")).unwrap();
    assert_eq!(fs::read_dir(work.join("corpus/x")).unwrap().count(), 0);

    remove_leftovers(&work).unwrap();
    assert_eq!(foreign(&work, &BTreeSet::new()).unwrap().len(), 5, "b, and four of theirs");
    assert_eq!(remove_listed(&work, &ours).unwrap(), theirs.iter().cloned().collect::<Vec<_>>());
    assert_eq!(files_below(&work).unwrap().len(), 5, "four of theirs, and the list");
    theirs.iter().for_each(|name| fs::remove_file(work.join(name)).unwrap());
    assert!(remove_listed(&work, &ours).unwrap().is_empty() && !work.exists());
    assert!(remove_listed(&work, &ours).unwrap().is_empty(), "what another process has removed is gone");
}

#[test]
fn overlaps_are_seen_through_dots_links_and_what_is_not_there_yet() {
    let dir = tempfile::tempdir().unwrap();
    let root = resolve(dir.path()).unwrap();
    let at = |name: &str| root.join(name);
    put(&at("rec/part/x.csv"), "");
    put(&at("recordings/x.csv"), "");
    #[cfg(unix)]
    for (target, link) in [
        ("rec", "link"),
        ("later/folder", "dangling"),
        ("link/part", "chain"),
        ("circle2", "circle1"),
        ("circle1", "circle2"),
    ] {
        std::os::unix::fs::symlink(target, at(link)).unwrap();
    }
    for (output, input, expected) in [
        ("rec", "rec", Some(PathRelation::Same)),
        ("rec/new/deep", "rec", Some(PathRelation::Inside)),
        ("rec", "rec/part/x.csv", Some(PathRelation::Contains)),
        ("rec/../rec/./part", "rec/part", Some(PathRelation::Same)),
        ("nowhere/../rec/out", "rec", Some(PathRelation::Inside)),
        ("rec", "recordings", None),
        ("rec/part", "rec/other", None),
        ("out", "rec", None),
        #[cfg(unix)]
        ("link", "rec", Some(PathRelation::Same)),
        #[cfg(unix)]
        ("rec/out", "link", Some(PathRelation::Inside)),
        #[cfg(unix)]
        ("chain/../out", "rec", Some(PathRelation::Inside)),
        #[cfg(unix)]
        ("dangling/out", "later/folder", Some(PathRelation::Inside)),
        #[cfg(unix)]
        ("later", "dangling", Some(PathRelation::Contains)),
    ] {
        let (from, to) = (at(output), at(input));
        let found = match check_overlap(&from, [("recordings", to.as_path())]) {
            Err(Error::Overlap { relation, .. }) => Some(relation),
            outcome => outcome.map(|()| None).unwrap(),
        };
        assert_eq!(found, expected, "{output} and {input}");
    }
    #[cfg(unix)]
    assert!(resolve(&at("circle1/x")).unwrap_err().to_string().contains("form a loop"));
    // As many links as Linux follows, and one more.
    #[cfg(unix)]
    (1..=41).for_each(|i| std::os::unix::fs::symlink(format!("to{}", i - 1), at(&format!("to{i}"))).unwrap());
    #[cfg(unix)]
    assert!(resolve(&at("to40")).unwrap() == at("to0") && resolve(&at("to41")).is_err());
    assert!(resolve(Path::new("x/../y")).unwrap().ends_with("y") && resolve(Path::new("y")).unwrap().is_absolute());
}

#[test]
fn a_refusal_says_what_is_where_and_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    put(&dir.path().join("rec/x.csv"), "");
    let input = dir.path().join("rec");
    let error = check_overlap(&input.join("out"), [("inputs.0", input.as_path())]).unwrap_err().to_string();
    for part in ["rec/out", "lies inside the input inputs.0", "nothing was changed", "choose another output"] {
        assert!(error.contains(part), "{error}");
    }
    let found = ["a", "b", "c", "d", "e"].map(PathBuf::from).to_vec();
    let error = Error::Foreign { path: "figures".into(), found }.to_string();
    assert!(error.contains("figures: it holds a, b, c and 2 more, which djinn did not write"), "{error}");
}

#[test]
fn a_second_name_is_of_the_whole_file_and_on_the_list() {
    let dir = tempfile::tempdir().unwrap();
    let (from, to) = (dir.path().join("a"), dir.path().join("out/b"));
    write(&from, "new");
    fs::create_dir(dir.path().join("out")).unwrap();
    keep_list(&dir.path().join("out")).unwrap();
    link_or_copy(&from, &to).unwrap();
    assert_eq!(fs::read_to_string(&to).unwrap(), "new");
    // A file that is there already is replaced by a copy, and the other name of its content stays as it is.
    write(&from, "newer");
    assert_eq!(fs::read_to_string(&to).unwrap(), "new");
    link_or_copy(&from, &to).unwrap();
    assert_eq!(fs::read_to_string(&to).unwrap(), "newer");
    assert_eq!(listed(&dir.path().join("out")).unwrap().unwrap(), [PathBuf::from("b")].into());
    assert!(link_or_copy(&dir.path().join("missing"), &to).is_err());
}

#[test]
fn a_place_has_one_writer() {
    let dir = tempfile::tempdir().unwrap();
    let lock = Lock::in_folder(dir.path()).unwrap();
    let busy = Lock::in_folder(dir.path()).unwrap_err().to_string();
    assert!(busy.contains(&format!("in use by process {}", std::process::id())), "{busy}");
    drop(lock);
    Lock::in_folder(dir.path()).unwrap();

    let out = dir.path().join("out");
    let lock = Lock::beside(&out).unwrap();
    assert!(matches!(Lock::beside(&out), Err(Error::Busy { .. })));
    drop(lock);
    drop(Lock::beside(&out).unwrap());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "the lock of the folder alone");
    // A file with this name that another program wrote is not emptied.
    fs::write(dir.path().join(LOCK_FILE), "yarn lockfile v1").unwrap();
    assert!(matches!(Lock::in_folder(dir.path()), Err(Error::Foreign { .. })));
    assert_eq!(fs::read_to_string(dir.path().join(LOCK_FILE)).unwrap(), "yarn lockfile v1");
}

#[test]
fn a_folder_appears_whole_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("new/out");
    let folder = NewFolder::begin(&out, []).unwrap();
    write(&folder.path().join("lanes.parquet"), "half");
    assert!(!out.exists());
    assert!(matches!(NewFolder::begin(&out, []), Err(Error::Busy { .. })));
    drop(folder);
    assert_eq!(fs::read_dir(dir.path().join("new")).unwrap().count(), 0);

    // A killed process left its folder, into which another program put a file: ours goes, theirs stays.
    let killed = NewFolder::begin(&out, []).unwrap();
    write(&killed.path().join("lanes.parquet"), "half");
    put(&killed.path().join("thesis.doc"), "years of work");
    let left = dir.path().join("left");
    fs::rename(killed.path(), &left).unwrap();
    drop(killed);
    let left_again = unique_partial(&out);
    fs::rename(&left, &left_again).unwrap();
    fs::create_dir(&out).unwrap();
    // The folder of another command at work stays, too.
    let beside = out.with_file_name("beside");
    fs::create_dir(&beside).unwrap();
    keep_list(&beside).unwrap();
    write(&beside.join("a.parquet"), "half");
    let folder = NewFolder::begin(&out, []).unwrap();
    assert!(beside.join("a.parquet").exists());
    assert!(left_again.join("thesis.doc").exists() && !left_again.join("lanes.parquet").exists());
    write(&folder.path().join("manifest.json"), "whole");
    folder.commit().unwrap();
    assert_eq!(files_below(&out).unwrap(), [PathBuf::from("manifest.json")]);
    assert!(matches!(NewFolder::begin(&out, []), Err(Error::Exists { .. })));
    assert!(matches!(NewFolder::begin(&out.join("sub"), [("corpus", out.as_path())]), Err(Error::Overlap { .. })));
}

#[test]
fn what_appears_meanwhile_is_not_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let folder = NewFolder::begin(&out, []).unwrap();
    write(&folder.path().join("manifest.json"), "whole");
    put(&out.join("thesis.doc"), "years of work");
    assert!(matches!(folder.commit(), Err(Error::Exists { .. })));
    assert_eq!(fs::read_to_string(out.join("thesis.doc")).unwrap(), "years of work");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn messages_call_copies_by_their_names() {
    let dir = tempfile::tempdir().unwrap();
    let message = format!("cannot read {}/d", dir.path().display());
    call(dir.path(), "s3://bucket/run".to_owned());
    assert_eq!(in_their_names(&message), "cannot read s3://bucket/run/d");
    assert_eq!(in_their_names("cannot read x"), "cannot read x");
}
