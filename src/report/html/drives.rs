//! The page of drives.

use super::plain::plain_table;
use super::scenes::{keys_help, player};
use super::{COURSES, PLAYER, Section, facts, page};
use crate::report::drives::{DriveCell, DriveGrid, DrivesPage};
use crate::report::number::count;
use maud::{Markup, PreEscaped, html};

/// The page as one self-contained HTML file: equal content gives equal bytes.
pub fn render_drives(content: &DrivesPage) -> String {
    let mut sections = Vec::new();
    let n_drawn = content.scenes.len();
    let scenes = html! {
        p class="note" {
            "The careful driver of UN Regulation No. 157 survives " (count(content.n_matter as u64))
            @if content.n_matter == 1 { " scenario" } @else { " scenarios" } " that this driver does not"
            @if n_drawn > 0 { "; those in which it has to brake hardest come first" }
            @if n_drawn < content.n_matter { ", and the first " (n_drawn) " are drawn" } "."
        }
        @if n_drawn > 0 {
            p class="note" {
                "The careful driver comes first in each, then the driver of this page: the same past second (dotted), \
                 and what came of it. The vehicle that they drive is blue, who takes part in the event orange. \
                 Outlines are where a drive ends, faint ones a second apart on the way there; a drive ends when it \
                 fails. The curves below are of the second drive."
            }
            (keys_help())
        }
        (player(&content.scenes))
    };
    sections.push(Section::new("scenes", "Failures that matter", scenes));
    if !content.grids.is_empty() {
        let grids = html! {
            p class="note" {
                "By what is within 50 m of the center, and by two parameters of the event, each in parts with as many \
                 scenarios; 2/7: fails 2 of 7. "
                span class="key full" { "none that the careful driver survives" } " "
                span class="key short" { "some that it survives" } " "
                span class="key beyond" { "the careful driver fails some, too" } ": the boundary of what it survives. "
                span class="key infeasible" { "–" } " no scenario."
            }
            @for grid in &content.grids { (heat_map(grid)) }
        };
        sections.push(Section::new("parameters", "Where it fails", grids));
    }
    let tables = html! { @for table in &content.tables { (plain_table(table)) } };
    sections.push(Section::new("outcomes", "Outcomes and traffic", tables));
    let scripts = (n_drawn > 0).then(|| html! { script { @for part in [COURSES, PLAYER] { (PreEscaped(part)) } } });
    page(&content.title, &facts(&content.facts), &sections, &scripts.unwrap_or_default())
}

fn heat_map(grid: &DriveGrid) -> Markup {
    let [across, down] = &grid.axes;
    html! {
        h3 { (grid.title.replace('_', " ")) }
        table class="bucket-grid" {
            thead {
                tr {
                    th scope="col" { (down) " ↓, " (across) " →" }
                    @for column in &grid.names[0] { th scope="col" class="n" { (column) } }
                }
            }
            tbody {
                @for (row, cells) in grid.names[1].iter().zip(&grid.cells) {
                    tr { th scope="row" { (row) } @for cell in cells { (drive_cell(cell)) } }
                }
            }
        }
    }
}

fn drive_cell(cell: &DriveCell) -> Markup {
    let state = match cell {
        DriveCell { n: 0, .. } => "infeasible",
        DriveCell { n_avoidable: 0, .. } => "full",
        _ => "short",
    };
    let beyond = if cell.n_careful_failed > 0 { " beyond" } else { "" };
    let title = format!(
        "{} scenarios: {} failed, of which the careful driver survives {}; it fails {}",
        cell.n, cell.n_failed, cell.n_avoidable, cell.n_careful_failed
    );
    html! {
        td class=(format!("n {state}{beyond}")) title=(title) {
            @if cell.n == 0 { "–" } @else { (cell.n_failed) "/" (cell.n) }
        }
    }
}
