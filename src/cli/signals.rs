//! What does a signal do to the program, and what does the user read then?

use super::exit;
use super::printer::stderr_line;
use crate::drive::kill_planners;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};
use signal_hook::iterator::Signals;
use signal_hook::low_level::{self, emulate_default_handler, signal_name};
use std::fmt::Display;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The time limit for printing the line.
const PATIENCE: Duration = Duration::from_secs(1);
/// The time that a phase that listens has to save its work. Batch systems give some two minutes of notice.
const GRACE: Duration = Duration::from_secs(100);

/// Advice on what an interruption leaves behind, and how to go on.
static LEFT: Mutex<Option<Left>> = Mutex::new(None);
/// Whether the work is to stop.
static MUST_STOP: AtomicBool = AtomicBool::new(false);
/// Whether the present phase has called [`must_stop`], and so will notice the request.
static LISTENS: AtomicBool = AtomicBool::new(false);

#[derive(Clone)]
struct Left {
    advice: String,
    /// Whether the same command resumes the work.
    resumes: bool,
}

/// Sets the advice for work that has to begin anew after a signal, in words that follow "ended by SIGTERM: ".
pub(super) fn leaves(advice: String) {
    *left() = Some(Left { advice, resumes: false });
}

/// [`leaves`] for work that the same command resumes: SIGTERM and SIGUSR1 then end it with the exit code for that.
pub(super) fn leaves_resumable(advice: String) {
    *left() = Some(Left { advice, resumes: true });
}

/// The advice after a signal.
pub(super) fn advice() -> Option<String> {
    left().clone().map(|left| left.advice)
}

/// Whether the work is to stop. A phase that calls this is given time to save its work.
pub(super) fn must_stop() -> bool {
    LISTENS.store(true, Ordering::Relaxed);
    MUST_STOP.load(Ordering::Relaxed)
}

/// Marks the beginning of a phase, which has not called [`must_stop`] yet.
pub(super) fn phase_begins() {
    LISTENS.store(false, Ordering::Relaxed);
}

/// Watches for the signals that end the program. SIGINT and SIGHUP end it at once, so that a shell sees 128 plus the
/// number of the signal. So do SIGTERM and SIGUSR1, by which batch systems announce that they will take the machine, if
/// the work has to begin anew. If the same command resumes it, they let a phase that listens save its work, and the
/// exit code tells that it can be resumed.
///
/// No file is cleaned up: at every moment, each is whole under its name or marked as partial, and the next command
/// handles the rest. Planners are ended, with all that they have started. Signals that the parent ignores, as `nohup`
/// does with SIGHUP, stay ignored.
pub(super) fn watch() {
    let ignored = ignored_signals();
    let wanted = [SIGTERM, SIGINT, SIGHUP, SIGUSR1].into_iter().filter(|signal| ignored & (1 << (signal - 1)) == 0);
    // If signals cannot be watched, they end the program without a message.
    let Ok(mut signals) = Signals::new(wanted) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let name = signal_name(signal).unwrap_or("a signal");
            let left = left().clone();
            let resumes = [SIGTERM, SIGUSR1].contains(&signal) && left.as_ref().is_some_and(|left| left.resumes);
            let ended = format!(
                "ended by {name}: {}",
                left.map_or_else(|| "nothing was written".to_owned(), |left| left.advice)
            );
            if !resumes {
                tell(ended);
                kill_planners();
                // Returns only if the signal cannot be raised; then the next one is awaited.
                let _ = emulate_default_handler(signal);
            } else if !MUST_STOP.swap(true, Ordering::Relaxed) {
                if LISTENS.load(Ordering::Relaxed) {
                    tell(format!("{name}: stopping as soon as finished work is saved"));
                }
                std::thread::spawn(move || end_unless_listening(ended));
            }
        }
    });
}

/// Ends the program once the present phase does not listen or its time is up.
fn end_unless_listening(ended: String) {
    let began = Instant::now();
    while LISTENS.load(Ordering::Relaxed) && began.elapsed() < GRACE {
        std::thread::sleep(Duration::from_millis(50));
    }
    tell(ended);
    kill_planners();
    low_level::exit(i32::from(exit::LATER));
}

/// Prints a line on a thread of its own: a blocked terminal must not keep the program alive.
fn tell(line: impl Display + Send + 'static) {
    // On a terminal, a progress bar may stand in the line.
    let begin = if std::io::stderr().is_terminal() { "\n" } else { "" };
    let (told, telling) = channel::<()>();
    std::thread::spawn(move || {
        stderr_line(&format_args!("{begin}{line}"));
        drop(told);
    });
    let _ = telling.recv_timeout(PATIENCE);
}

fn left() -> MutexGuard<'static, Option<Left>> {
    LEFT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The signals that the process ignores, one bit each, signal 1 in the lowest; none if the system does not report them.
fn ignored_signals() -> u64 {
    let status = fs_err::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
