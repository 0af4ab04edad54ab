//! What does the user read when a signal ends the program?

use super::printer::stderr_line;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::{emulate_default_handler, signal_name};
use std::io::IsTerminal;
use std::sync::mpsc::channel;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// How long the line may take.
const PATIENCE: Duration = Duration::from_secs(1);

/// What stays of the work at hand, and how to go on.
static ADVICE: Mutex<Option<String>> = Mutex::new(None);

/// Says from now on what a signal leaves behind, in words that follow "ended by SIGTERM: ".
pub(super) fn leaves(advice: String) {
    *ADVICE.lock().unwrap_or_else(PoisonError::into_inner) = Some(advice);
}

/// Watches for the signals that ask the program to end: it then says what it leaves and ends by that signal, at once, so that a shell sees
/// 128 and its number. Nothing is tidied up: whatever is written is whole under its name or called partial at every moment, and the next
/// command knows what to do with it. What the parent wants ignored, as `nohup` does with SIGHUP, stays ignored.
pub(super) fn watch() {
    let ignored = ignored_signals();
    let wanted = [SIGTERM, SIGINT, SIGHUP].into_iter().filter(|signal| ignored & (1 << (signal - 1)) == 0);
    // Where signals cannot be watched they end the program without a word.
    let Ok(mut signals) = Signals::new(wanted) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let name = signal_name(signal).unwrap_or("a signal");
            let advice = ADVICE.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let advice = advice.unwrap_or_else(|| "nothing was written".to_owned());
            // On a terminal, a progress bar may stand in the line.
            let begin = if std::io::stderr().is_terminal() { "\n" } else { "" };
            let (told, telling) = channel::<()>();
            std::thread::spawn(move || {
                stderr_line(&format_args!("{begin}ended by {name}: {advice}"));
                drop(told);
            });
            // Nobody may be reading: that must not keep the program alive.
            let _ = telling.recv_timeout(PATIENCE);
            // It returns only where the signal cannot be raised; the next one is watched for then.
            let _ = emulate_default_handler(signal);
        }
    });
}

/// The signals that the process was told to ignore, a bit each, the lowest that of signal 1; none where the system does not tell.
fn ignored_signals() -> u64 {
    let status = fs_err::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
