//! How does a terminal show the progress of long work, and what is left of it in a pipe?

use super::args::OutputArgs;
use super::printer::{Printer, stderr_line};
use crate::progress::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Shows a bar with rate and time left on a terminal; elsewhere one line when a phase starts and one when it ends.
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
}

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
        });
    }

    fn advance(&self, n: u64) {
        if let Some(phase) = self.phase().as_mut() {
            phase.n_done += n;
            if let Some(bar) = &phase.bar {
                bar.inc(n);
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
    /// `ingest: 1990 scenes in 12.3 s (161.8/s), loss 0.12`.
    fn closing_line(&self) -> String {
        let seconds = self.began.elapsed().as_secs_f64();
        let Self { name, unit, n_done, .. } = self;
        if *n_done == 0 {
            return format!("{name}: done in {seconds:.1} s");
        }
        let rate = if seconds > 0.0 { *n_done as f64 / seconds } else { 0.0 };
        let note = if self.note.is_empty() { String::new() } else { format!(", {}", self.note) };
        format!("{name}: {n_done} {unit} in {seconds:.1} s ({rate:.1}/s){note}")
    }
}

fn bar(phase: &str, total: u64, unit: &str) -> ProgressBar {
    let (bar, template) = if total == 0 {
        (ProgressBar::new_spinner(), "{prefix:.bold} {spinner} {human_pos} {unit} ({per_sec}) {msg}")
    } else {
        let template = "{prefix:.bold} [{bar:30}] {human_pos}/{human_len} {unit} ({per_sec}, {eta} left) {msg}";
        (ProgressBar::new(total), template)
    };
    let template = template.replace("{unit}", &unit.replace(['{', '}'], ""));
    // The template is ours and always well-formed; were it not, indicatif's own style serves as well.
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(phase.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
