//! A small check of HTML: tags nest and close, attributes are quoted, ids are unique, fragment links have targets.

use std::collections::BTreeSet;

const VOID: [&str; 4] = ["meta", "input", "br", "hr"];

/// Panics at the first fault of a page.
pub(crate) fn check(page: &str) {
    check_elements(page.strip_prefix("<!DOCTYPE html>").expect("the page says what it is"));
}

/// Panics at the first fault of a drawing.
pub(crate) fn check_svg(drawing: &str) {
    assert!(drawing.starts_with("<svg "), "the drawing says what it is");
    check_elements(drawing);
}

fn check_elements(mut rest: &str) {
    let mut open: Vec<String> = Vec::new();
    let (mut ids, mut links) = (BTreeSet::new(), Vec::new());
    while let Some(start) = rest.find('<') {
        assert!(!rest[..start].contains('>'), "a stray > in {:?}", &rest[..start]);
        let end = start + rest[start..].find('>').expect("every tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "</{name}> closes something else");
            continue;
        }
        let name = tag.split_whitespace().next().expect("every tag has a name");
        assert!(name.bytes().all(|b| b.is_ascii_alphanumeric()), "<{name}>");
        assert_eq!(tag.matches('"').count() % 2, 0, "<{tag}>");
        for (attribute, value) in attributes(tag) {
            match attribute {
                "id" => assert!(ids.insert(value.to_owned()), "the id {value} occurs twice"),
                "href" => links.push(value.trim_start_matches('#').to_owned()),
                "aria-labelledby" => links.push(value.to_owned()),
                _ => {}
            }
        }
        // Script and style hold text only, up to their end tag.
        if name == "script" || name == "style" {
            let end = rest.find(&format!("</{name}>")).expect("script and style end");
            rest = &rest[end..];
        }
        if !VOID.contains(&name) {
            open.push(name.to_owned());
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
    for link in links {
        assert!(ids.contains(&link), "nothing has the id {link}");
    }
}

fn attributes(tag: &str) -> Vec<(&str, &str)> {
    let mut found = Vec::new();
    let mut rest = tag;
    while let Some(equals) = rest.find("=\"") {
        let name = rest[..equals].rsplit(char::is_whitespace).next().unwrap_or_default();
        let value = &rest[equals + 2..];
        let end = value.find('"').expect("quotes are paired");
        found.push((name, &value[..end]));
        rest = &value[end + 1..];
    }
    found
}
