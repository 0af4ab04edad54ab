//! The grid of a request's buckets: one parameter across, the others down, and in each cell the accepted and requested
//! scenarios.

use crate::generate::BucketSummary;
use crate::report::number::{count, optional};
use maud::{Markup, html};

/// The grid, for buckets of at least two parameters.
pub(super) fn grid(buckets: &[BucketSummary]) -> Option<Markup> {
    let (across, down) = buckets.first()?.parts.split_last().filter(|(_, down)| !down.is_empty())?;
    // The last parameter changes fastest: a row of the grid is a run of buckets that differ only in it.
    let rows: Vec<&[BucketSummary]> = buckets.chunk_by(|a, b| fixed(a) == fixed(b)).collect();
    Some(html! {
        table class="bucket-grid" {
            thead {
                tr {
                    @for part in down { th scope="col" { (part.parameter) } }
                    @for bucket in rows.first().copied().into_iter().flatten() {
                        th scope="col" class="n" { (range(bucket.parts.last().map_or("", |part| &part.range))) }
                    }
                }
            }
            tbody {
                @for row in rows {
                    tr {
                        @for part in row.iter().take(1).flat_map(fixed_parts) {
                            th scope="row" { (range(&part.range)) }
                        }
                        @for bucket in row { (cell(bucket)) }
                    }
                }
            }
        }
        p class="note" {
            "Accepted of wanted; across: " (across.parameter) ". " span class="key full" { "full" } " "
            span class="key short" { "short" } " "
            span class="key infeasible" { "no pair can fall into it" } ". Point at a cell for its pairs and its cost."
        }
    })
}

fn cell(bucket: &BucketSummary) -> Markup {
    let (state, text) = if bucket.n_feasible == 0 && bucket.n_accepted == 0 {
        ("infeasible", "–".to_owned())
    } else {
        let state = if bucket.n_accepted < bucket.n_wanted { "short" } else { "full" };
        (state, format!("{}/{}", count(bucket.n_accepted), count(bucket.n_wanted)))
    };
    let title = format!(
        "{} pairs can fall into it; {} evaluations per accepted scenario",
        count(bucket.n_feasible as u64),
        optional(bucket.n_evaluations_per_accepted())
    );
    html! { td class=(format!("n {state}")) title=(title) { (text) } }
}

fn fixed_parts(bucket: &BucketSummary) -> &[crate::generate::BucketPart] {
    bucket.parts.split_last().map_or(&[], |(_, fixed)| fixed)
}

fn fixed(bucket: &BucketSummary) -> Vec<&str> {
    fixed_parts(bucket).iter().map(|part| part.range.as_str()).collect()
}

/// A range of a bucket for display.
pub(super) fn range(text: &str) -> String {
    text.replace('-', "−").replace("..", " to ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::BucketPart;

    fn bucket(idx: usize, ranges: &[&str], (n_feasible, n_accepted): (usize, u64)) -> BucketSummary {
        let part = |(i, range): (usize, &&str)| BucketPart { parameter: format!("p{i}"), range: (*range).to_owned() };
        BucketSummary {
            idx,
            parts: ranges.iter().enumerate().map(part).collect(),
            n_feasible,
            is_given_up: false,
            n_wanted: 5,
            n_accepted,
            n_surplus: 0,
            n_repeated: 0,
            n_near_duplicates: 0,
            accepted_by_arm: Vec::new(),
            hits_by_arm: Vec::new(),
            first_round_hits_by_arm: Vec::new(),
            n_samples_while_open: 10,
            n_evaluations_while_open: 20,
        }
    }

    #[test]
    fn every_bucket_has_a_cell_in_the_row_of_its_other_parameters() {
        let buckets = [
            bucket(0, &["-5..0", "0..5"], (3, 5)),
            bucket(1, &["-5..0", "5..10"], (2, 1)),
            bucket(2, &["0..5", "0..5"], (0, 0)),
            bucket(3, &["0..5", "5..10"], (1, 5)),
        ];
        let html = grid(&buckets).expect("two parameters").into_string();
        assert_eq!((html.matches("<tr>").count(), html.matches("<td").count()), (3, 4));
        let states: Vec<usize> =
            ["n full", "n short", "n infeasible"].iter().map(|s| html.matches(s).count()).collect();
        assert_eq!(states, [2, 1, 1]);
        assert!(html.contains("−5 to 0") && html.contains("1/5"));
        assert!(html.contains(&format!("{} evaluations per accepted", optional(Some(20.0)))));
        assert!(grid(&[bucket(0, &["0..5"], (1, 1))]).is_none());
    }
}
