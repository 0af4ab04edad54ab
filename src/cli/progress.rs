//! How does a terminal show the progress of long work, and how does a pipe?

use super::args::OutputArgs;
use super::printer::{Printer, stderr_line};
use super::signals;
use crate::progress::Progress;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Shows a bar with rate and time left on a terminal; otherwise a line when a phase starts and one when it ends.
pub(super) struct TerminalProgress {
    printer: Printer,
    style: Style,
    phase: Mutex<Option<Phase>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Style {
    Bars,
    Lines,
    Nothing,
}

struct Phase {
    name: String,
    unit: String,
    began: Instant,
    n_done: u64,
    note: String,
    bar: Option<ProgressBar>,
    /// Units in all; 0 when unknown.
    total: u64,
    /// When units were first reported, and how many: an interrupted run had done these before.
    counted_from: Option<(Instant, u64)>,
    /// When the time left is printed again, where there is no bar.
    next_estimate: Duration,
}

/// How long a phase without a bar runs before its first estimate of the time left; each later one takes three times as
/// long.
const FIRST_ESTIMATE: Duration = Duration::from_secs(20);

impl TerminalProgress {
    pub(super) fn new(output: &OutputArgs, printer: Printer) -> Self {
        let style = match () {
            () if output.quiet => Style::Nothing,
            () if output.no_progress || !std::io::stderr().is_terminal() => Style::Lines,
            () => Style::Bars,
        };
        Self { printer, style, phase: Mutex::new(None) }
    }

    fn phase(&self) -> MutexGuard<'_, Option<Phase>> {
        self.phase.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for TerminalProgress {
    fn start(&self, phase: &str, total: u64, unit: &str) {
        self.finish();
        signals::phase_begins();
        let bar = (self.style == Style::Bars).then(|| bar(phase, total, unit));
        if self.style == Style::Lines {
            let of = if total == 0 { String::new() } else { format!(": {total} {unit}") };
            stderr_line(&format_args!("{phase}{of}"));
        }
        *self.phase() = Some(Phase {
            name: phase.to_owned(),
            unit: unit.to_owned(),
            began: Instant::now(),
            n_done: 0,
            note: String::new(),
            bar,
            total,
            counted_from: None,
            next_estimate: FIRST_ESTIMATE,
        });
    }

    fn advance(&self, n: u64) {
        if let Some(phase) = self.phase().as_mut() {
            phase.n_done += n;
            if let Some(bar) = &phase.bar {
                bar.inc(n);
            } else if let Some(line) = phase.estimate(Instant::now()).filter(|_| self.style == Style::Lines) {
                stderr_line(&line);
            }
        }
    }

    fn note(&self, message: &str) {
        if let Some(phase) = self.phase().as_mut() {
            message.clone_into(&mut phase.note);
            if let Some(bar) = &phase.bar {
                bar.set_message(message.to_owned());
            }
        }
    }

    fn warn(&self, message: &str) {
        let line = self.printer.warning_line(message);
        match self.phase().as_ref().and_then(|phase| phase.bar.as_ref()) {
            Some(bar) => bar.println(line),
            // Warnings are shown even when quiet: quiet means no progress, not no problems.
            None => stderr_line(&line),
        }
    }

    fn must_stop(&self) -> bool {
        signals::must_stop()
    }

    fn finish(&self) {
        let Some(phase) = self.phase().take() else { return };
        if let Some(bar) = &phase.bar {
            bar.finish_and_clear();
        }
        if self.style != Style::Nothing {
            stderr_line(&phase.closing_line());
        }
    }
}

impl Phase {
    /// `train denoiser: 240 of 8000 steps, about 45 min left`, from time to time.
    fn estimate(&mut self, now: Instant) -> Option<String> {
        let (began, n_before) = *self.counted_from.get_or_insert((now, self.n_done));
        let elapsed = now.duration_since(began);
        if elapsed < self.next_estimate || self.total <= self.n_done || self.n_done <= n_before {
            return None;
        }
        self.next_estimate = elapsed * 3;
        let left_s = elapsed.as_secs_f64() * (self.total - self.n_done) as f64 / (self.n_done - n_before) as f64;
        let left = match left_s {
            s if s < 100.0 => format!("{s:.0} s"),
            s if s < 6_000.0 => format!("{:.0} min", s / 60.0),
            s => format!("{:.1} h", s / 3_600.0),
        };
        let Self { name, n_done, total, unit, .. } = self;
        Some(format!("{name}: {n_done} of {total} {unit}, about {left} left"))
    }

    /// `ingest: 1990 scenes in 12.3 s (162/s), loss 0.12`.
    fn closing_line(&self) -> String {
        let seconds = self.began.elapsed().as_secs_f64();
        let Self { name, unit, n_done, .. } = self;
        if *n_done == 0 {
            return format!("{name}: done in {seconds:.1} s");
        }
        let rate = per_second(if seconds > 0.0 { *n_done as f64 / seconds } else { 0.0 });
        let note = if self.note.is_empty() { String::new() } else { format!(", {}", self.note) };
        format!("{name}: {n_done} {unit} in {seconds:.1} s ({rate}){note}")
    }
}

/// A rate in its significant digits.
fn per_second(rate: f64) -> String {
    match rate {
        rate if rate >= 100.0 => format!("{rate:.0}/s"),
        rate if rate >= 1.0 => format!("{rate:.1}/s"),
        rate => format!("{rate:.2}/s"),
    }
}

/// Rate and time left, once both can be estimated.
fn pace(state: &ProgressState, to: &mut dyn Write) {
    let rate = per_second(state.per_sec());
    // Writing to a string cannot fail.
    let _ = match state.len() {
        _ if state.pos() == 0 => Ok(()),
        None => write!(to, "({rate})"),
        Some(_) => write!(to, "({rate}, {:#} left)", HumanDuration(state.eta())),
    };
}

/// A bar in one line, even in a terminal of 60 columns: the note is cut off where the terminal ends.
fn bar(phase: &str, total: u64, unit: &str) -> ProgressBar {
    let (bar, template) = if total == 0 {
        (ProgressBar::new_spinner(), "{prefix:.bold} {spinner} {human_pos} {unit} {pace} {wide_msg}")
    } else {
        (ProgressBar::new(total), "{prefix:.bold} [{bar:10}] {human_pos}/{human_len} {unit} {pace} {wide_msg}")
    };
    let template = template.replace("{unit}", &unit.replace(['{', '}'], ""));
    // The template is always well-formed; were it not, indicatif's own style serves as well.
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style.with_key("pace", pace).progress_chars("=> "));
    }
    bar.set_prefix(phase.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_phase_says_how_long_it_will_take() {
        let began = Instant::now();
        let mut phase = Phase {
            name: "train denoiser".to_owned(),
            unit: "steps".to_owned(),
            began,
            n_done: 500,
            note: String::new(),
            bar: None,
            total: 1_000,
            counted_from: None,
            next_estimate: FIRST_ESTIMATE,
        };
        let mut after = |seconds: u64, n_done: u64| {
            phase.n_done = n_done;
            phase.estimate(began + Duration::from_secs(seconds))
        };
        // Five hundred steps are from before an interruption.
        assert_eq!(after(0, 500), None);
        assert_eq!(after(10, 505), None);
        assert_eq!(after(30, 510).as_deref(), Some("train denoiser: 510 of 1000 steps, about 24 min left"));
        assert_eq!(after(60, 520), None);
        assert_eq!(after(90, 530).as_deref(), Some("train denoiser: 530 of 1000 steps, about 24 min left"));
    }
}
