//! The gallery of a request: one drawing for each bucket, linked to the scene below.

use crate::report::card::{CardBucket, SceneCard};
use crate::report::number::count;
use crate::report::svg::scene_panel;
use maud::{Markup, html};

/// Maximum number of drawings: each takes some tens of kilobytes of the page.
const N_DRAWN: usize = 24;

/// The first scenario of each bucket of a request among the `cards` of the page, if there is one.
pub(super) fn gallery(request: &str, cards: &[SceneCard]) -> Markup {
    let mut firsts: Vec<(usize, &SceneCard, &CardBucket)> = Vec::new();
    for (card_idx, card) in cards.iter().enumerate() {
        let Some(bucket) = card.key.bucket.as_ref().filter(|bucket| bucket.request == request) else { continue };
        if firsts.iter().all(|(_, _, known)| known.idx != bucket.idx) {
            firsts.push((card_idx, card, bucket));
        }
    }
    html! {
        @if !firsts.is_empty() {
            div class="bucket-gallery" {
                @for (card_idx, card, bucket) in firsts.iter().take(N_DRAWN) { (figure(*card_idx, card, bucket)) }
            }
            p class="note" {
                "The first accepted scenario of each bucket"
                @if firsts.len() > N_DRAWN {
                    ", of " (count(N_DRAWN as u64)) " of " (count(firsts.len() as u64)) " buckets"
                }
                "; a drawing leads to the scene beside its recording."
            }
        }
    }
}

fn figure(card_idx: usize, card: &SceneCard, bucket: &CardBucket) -> Markup {
    let roles = card.roles();
    html! {
        @if let Some(panel) = card.panels.iter().find(|panel| !panel.is_recorded) {
            figure {
                a href=(format!("#scene-{card_idx}")) { (scene_panel(card, panel, &roles)) }
                figcaption { (bucket.ranges) }
            }
        }
    }
}
