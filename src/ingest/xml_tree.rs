//! An XML document as a tree of elements.

use super::error::Malformed;
use super::map_text::line_at;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;

/// The greatest depth of documents in these formats.
const MAX_DEPTH: usize = 32;

/// An element with its content, without comments.
#[derive(Debug, Default)]
pub(super) struct Element {
    pub(super) name: String,
    /// The line on which it begins, from 1.
    pub(super) line: usize,
    attributes: Vec<(String, String)>,
    children: Vec<Self>,
    text: String,
}

impl Element {
    /// The root of a document.
    pub(super) fn parse(text: &str) -> Result<Self, Malformed> {
        let mut xml = Reader::from_str(text);
        let mut open: Vec<Self> = Vec::new();
        let mut root = None;
        let (mut line, mut counted) = (1, 0);
        loop {
            let at = usize::try_from(xml.buffer_position()).unwrap_or(text.len());
            line += line_at(&text.as_bytes()[counted..], at - counted) - 1;
            counted = at;
            let within = |what: String| Malformed::from(format!("line {line}: {what}"));
            let event = xml.read_event().map_err(|error| {
                let is_short = error.to_string().contains("end of input");
                within(format!("{error}{}", if is_short { "; the file is cut short" } else { "" }))
            })?;
            let closed = match event {
                Event::Start(_) if open.len() == MAX_DEPTH => {
                    return Err(within(format!("more than {MAX_DEPTH} elements within each other")));
                }
                Event::Start(start) => {
                    open.push(Self::begin(&start, line)?);
                    None
                }
                Event::Empty(start) => Some(Self::begin(&start, line)?),
                Event::End(_) => open.pop(),
                Event::Text(text) => {
                    if let Some(element) = open.last_mut() {
                        element.text.push_str(text.trim());
                    }
                    None
                }
                // Entities could grow without bound, and no file of these formats has any.
                Event::DocType(_) => {
                    return Err(within("a document type declaration, which these formats never have".into()));
                }
                Event::Eof => break,
                _ => None,
            };
            match (closed, open.last_mut()) {
                (Some(element), Some(parent)) => parent.children.push(element),
                (Some(element), None) if root.is_none() => root = Some(element),
                (Some(element), None) => return Err(within(format!("<{}> after the end of the root", element.name))),
                (None, _) => {}
            }
        }
        match (open.last(), root) {
            (Some(element), _) => {
                Err(format!("line {line}: ends within <{}>; the file is cut short", element.name).into())
            }
            (None, Some(root)) => Ok(root),
            (None, None) => Err("line 1: holds no element, and is no XML".into()),
        }
    }

    fn begin(start: &BytesStart<'_>, line: usize) -> Result<Self, Malformed> {
        let mut attributes = Vec::new();
        for attribute in start.attributes() {
            let attribute = attribute.map_err(|what| format!("line {line}: {what}"))?;
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            let value = value.map_err(|what| format!("line {line}: {what}"))?.into_owned();
            attributes.push((attribute.key.as_ref().to_owned(), value));
        }
        Ok(Self { name: start.name().as_ref().to_owned(), line, attributes, ..Self::default() })
    }

    pub(super) fn children(&self) -> impl Iterator<Item = &Self> {
        self.children.iter()
    }

    pub(super) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> + Clone {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The first element along a path of names.
    pub(super) fn find(&self, path: &[&str]) -> Option<&Self> {
        path.iter().try_fold(self, |element, name| element.children.iter().find(|child| child.name == *name))
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// An attribute that names an element by its number.
    pub(super) fn id(&self, name: &str) -> Result<i64, Malformed> {
        let text = self.attribute(name).unwrap_or_default();
        let expected =
            || format!("<{}> on line {} has {name} \"{text}\", expected a whole number", self.name, self.line);
        text.trim().parse().map_err(|_| expected().into())
    }

    /// The finite number of an attribute; `default` if there is none.
    pub(super) fn float(&self, name: &str, default: Option<f64>) -> Result<f64, Malformed> {
        let text = self.attribute(name);
        let value = text.map_or(default, |text| text.trim().parse().ok()).filter(|value: &f64| value.is_finite());
        value.ok_or_else(|| {
            let found = text.map_or_else(|| format!("no {name}"), |text| format!("{name} \"{text}\""));
            format!("<{}> on line {} has {found}, expected a number", self.name, self.line).into()
        })
    }

    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// The finite number at the end of a path.
    pub(super) fn number(&self, path: &[&str]) -> Result<f64, Malformed> {
        let text = self.find(path).map(Self::text);
        let value = text.and_then(|text| text.parse::<f64>().ok()).filter(|value| value.is_finite());
        value.ok_or_else(|| {
            let found = text.map_or_else(|| "is missing".to_owned(), |text| format!("is \"{text}\""));
            let (path, Self { name, line, .. }) = (path.join("/"), self);
            format!("<{path}> within <{name}> on line {line} {found}, expected a number").into()
        })
    }
}
