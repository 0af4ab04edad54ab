//! Parts of the page that consist only of tables and charts.

use super::{Section, table};
use crate::report::plain::{PlainRow, PlainSection, PlainTable};
use crate::report::svg::line_chart;
use maud::{Markup, html};

pub(super) fn section(section: &PlainSection) -> Section {
    let body = html! {
        @if !section.note.is_empty() { p class="note" { (section.note) } }
        @for table in &section.tables { (plain_table(table)) }
        @if !section.charts.is_empty() { div class="grid" { @for chart in &section.charts { (line_chart(chart)) } } }
    };
    Section::new(section.id.clone(), section.title.clone(), body)
}

/// The table; columns whose cells are all numbers or empty are set as numbers.
pub(super) fn plain_table(plain: &PlainTable) -> Markup {
    let is_numeric: Vec<bool> =
        (0..plain.columns.len()).map(|i| i > 0 && plain.rows.iter().all(|row| is_number(row, i))).collect();
    let class = |i: usize| is_numeric[i].then_some("n");
    let head = html! {
        tr { @for (i, column) in plain.columns.iter().enumerate() { th scope="col" class=[class(i)] { (column) } } }
    };
    let body = html! {
        @for row in &plain.rows {
            tr class=[row.is_reference.then_some("reference")] {
                @for (i, cell) in row.cells.iter().take(plain.columns.len()).enumerate() {
                    @if i == 0 { th scope="row" { (cell) } } @else { td class=[class(i)] { (cell) } }
                }
            }
        }
    };
    table(&plain.caption, &head, &body)
}

fn is_number(row: &PlainRow, column: usize) -> bool {
    let first = row.cells.get(column).and_then(|cell| cell.chars().next());
    first.is_none_or(|c| c.is_ascii_digit() || matches!(c, '−' | '–' | '+'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_to_the_right_and_references_are_marked() {
        let mut plain = PlainTable::new("Which", &["Group", "Value", "Word"]);
        plain.push(vec!["<a>".into(), "−1.5 m".into(), "2 of them".into()]);
        plain.push(vec!["b".into(), "–".into(), "none".into()]);
        plain.rows[1].is_reference = true;
        let page = plain_table(&plain).into_string();
        for part in [
            r#"<th scope="col" class="n">Value</th><th scope="col">Word</th>"#,
            r#"<tr><th scope="row">&lt;a&gt;</th><td class="n">−1.5 m</td><td>2 of them</td></tr>"#,
            r#"<tr class="reference">"#,
        ] {
            assert!(page.contains(part), "{part} is missing in {page}");
        }
    }
}
