//! `NOTICE.txt`: what users of an export must know.

use super::report::meaning;
use super::{EgoMotion, ExportReport};

/// Width of the text.
const WIDTH: usize = 100;

/// The text of `NOTICE.txt`: content, terms, notes for readers, and a list of omissions.
pub(super) fn text(report: &ExportReport) -> String {
    let mut text = String::from("GENERATED TRAFFIC SCENARIOS\n===========================\n\n");
    let what = format!(
        "{} scenarios with {} tracks, exported by djinn as {}: {}. What was not observed is sampled by a model: nobody \
         drove these scenarios.",
        report.n_scenarios,
        report.n_tracks,
        report.format.name(),
        report.format.description()
    );
    paragraph(&mut text, &what);
    heading(&mut text, "Sources and terms");
    paragraph(
        &mut text,
        "The terms of the recordings apply to everything derived from them. Pass this notice on with the files.",
    );
    for (dataset, terms) in &report.sources {
        paragraph(&mut text, &format!("{dataset}: {terms}"));
    }
    heading(&mut text, "Files");
    paragraph(&mut text, report.format.notes());
    paragraph(
        &mut text,
        "index.tsv: the file and name of each scenario. first_timestep is the scenario's timestep at the file's first \
         time.",
    );
    paragraph(
        &mut text,
        "tracks.tsv: the name of each track in the file, the ego, and roles in the event. In both tables, texts that a \
         spreadsheet would take for formulas begin with an apostrophe.",
    );
    paragraph(&mut text, &format!("The ego is {}.", report.ego.words()));
    paragraph(&mut text, "export.json: the options of the export, and what was left out, by reason. Written last.");
    paragraph(&mut text, "Positions are those of the recording's frame, in meters; headings in radians.");
    if report.ego_motion == EgoMotion::Free {
        paragraph(
            &mut text,
            "From the present on, the ego is left to the driving function under test; before, it moves as in the \
             scenario.",
        );
    }
    heading(&mut text, "Left out and assumed");
    for (what, left_out) in [("scenarios", &report.scenarios_left_out), ("tracks", &report.tracks_left_out)] {
        for (reason, found) in left_out {
            paragraph(&mut text, &format!("{} {what} left out: {}.", found.count, meaning(reason)));
        }
    }
    for (what, n) in &report.assumed {
        paragraph(&mut text, &format!("{}: {n} in all.", meaning(what)));
    }
    if report.scenarios_left_out.is_empty() && report.tracks_left_out.is_empty() && report.assumed.is_empty() {
        paragraph(&mut text, "Nothing.");
    }
    text
}

fn heading(text: &mut String, heading: &str) {
    text.push_str(&format!("\n{heading}\n{}\n\n", "-".repeat(heading.len())));
}

/// Adds lines of at most [`WIDTH`] characters, if words allow it.
fn paragraph(text: &mut String, paragraph: &str) {
    let mut width = 0;
    for word in paragraph.split_whitespace() {
        let n = word.chars().count();
        if width > 0 && width + 1 + n > WIDTH {
            text.push_str("\n  ");
            width = 2;
        } else if width > 0 {
            text.push(' ');
            width += 1;
        }
        text.push_str(word);
        width += n;
    }
    text.push('\n');
}
