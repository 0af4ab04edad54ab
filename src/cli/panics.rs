//! What does the user read when the program has a bug?

use super::commands::NO_THREADS;
use crate::containment::is_contained;
use crate::engine::{Failure, Result};
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::sync::{Mutex, PoisonError};

/// The place and message of the first panic in the process that nothing contains. Later ones are its consequences.
static FIRST: Mutex<Option<String>> = Mutex::new(None);

/// The result of `work`. A panic in it, on any thread, is a bug of ours: it becomes a failure with the place in the
/// source and advice to report it. Panics over damaged files are contained where the files are read, and reported as
/// errors.
pub(super) fn told(work: impl FnOnce() -> Result<()>) -> Result<()> {
    std::panic::set_hook(Box::new(|panic| {
        if !is_contained() {
            FIRST.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| description(panic));
        }
    }));
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(failure()))
}

fn description(panic: &PanicHookInfo<'_>) -> String {
    let place = panic.location().map_or_else(|| "an unknown place".to_owned(), ToString::to_string);
    let payload = panic.payload();
    let text = payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    format!("{place}: {}", text.unwrap_or("no message"))
}

fn failure() -> Failure {
    let what = FIRST.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default();
    if let Some((_, why)) = what.split_once("failed to spawn thread: ") {
        return Failure::fault(anyhow::anyhow!("cannot start another thread: {why}")).with_hint(NO_THREADS);
    }
    Failure::fault(anyhow::anyhow!("djinn {} failed because of a bug at {what}", env!("CARGO_PKG_VERSION"))).with_hint(
        "please report these lines with the command, its configuration and the run folder's log.txt; finished work is \
         kept, and the same command continues from there",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Blame;

    #[test]
    fn a_panic_becomes_a_fault_with_its_place_whatever_the_thread() {
        let indexed = |numbers: &[i32]| numbers[numbers.len()];
        let on_another_thread = || rayon::join(|| indexed(&[1, 2]), || 0);
        let failure = told(|| {
            on_another_thread();
            Ok(())
        })
        .unwrap_err();
        assert_eq!(failure.blame, Blame::Fault);
        let said = failure.error.to_string();
        assert!(said.contains("panics.rs:") && said.contains("index out of bounds"), "{said}");
        assert!(failure.hint.is_some_and(|hint| hint.contains("please report")));
        assert!(told(|| Ok(())).is_ok());
        drop(std::panic::take_hook());
    }
}
