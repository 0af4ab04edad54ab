//! Which tests did not test, because what they need is not here?

use std::io::Write;

/// Reports that the running test, or a part of it, is left out for want of `need`, and why: on stderr, past the
/// harness, which keeps to itself what tests print, and in the file that the environment variable `DJINN_SKIPPED`
/// names. `scripts/check.sh` ends with the content of that file, and `.ci/run` fails on every need in it that it does
/// not allow to be missing.
pub(crate) fn skipped(need: &str, why: &str) {
    let thread = std::thread::current();
    let line = format!("{need}\t{}: {why}\n", thread.name().unwrap_or("a test"));
    // Nobody reads it when the terminal is gone; the file counts.
    let _ = write!(std::io::stderr(), "skipped for want of {line}");
    if let Some(list) = std::env::var_os("DJINN_SKIPPED") {
        let list = fs_err::File::options().create(true).append(true).open(list);
        list.and_then(|mut list| list.write_all(line.as_bytes())).expect("the list of what is skipped can be written");
    }
}
