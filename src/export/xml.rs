//! XML documents as trees of elements, escaped and indented by `quick_xml`.

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, BytesText, Event};
use std::fmt::Display;
use std::io::{self, Write};

/// An element with its attributes and content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, String)>,
    children: Vec<Self>,
    text: Option<String>,
}

/// An empty element.
pub(super) const fn element(name: &'static str) -> Element {
    Element { name, attributes: Vec::new(), children: Vec::new(), text: None }
}

pub(super) fn leaf(name: &'static str, text: impl Display) -> Element {
    Element { text: Some(allowed(text)), ..element(name) }
}

/// The text with a replacement character for each one that XML cannot hold, escaped or not.
fn allowed(text: impl Display) -> String {
    let is_allowed =
        |c: char| matches!(c, '\t' | '\n' | '\r') || !(c.is_ascii_control() || ('\u{fffe}'..='\u{ffff}').contains(&c));
    text.to_string().chars().map(|c| if is_allowed(c) { c } else { char::REPLACEMENT_CHARACTER }).collect()
}

impl Element {
    /// Adds an attribute.
    pub(super) fn attr(mut self, name: &'static str, value: impl Display) -> Self {
        self.attributes.push((name, allowed(value)));
        self
    }

    pub(super) fn child(mut self, child: Self) -> Self {
        self.children.push(child);
        self
    }

    /// Adds these children.
    pub(super) fn children(mut self, children: impl IntoIterator<Item = Self>) -> Self {
        self.children.extend(children);
        self
    }

    pub(super) fn write_document(&self, sink: &mut dyn Write) -> io::Result<()> {
        let mut writer = Writer::new_with_indent(sink, b' ', 2);
        writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
        self.write(&mut writer)?;
        writer.get_mut().write_all(b"\n")
    }

    fn write(&self, writer: &mut Writer<&mut dyn Write>) -> io::Result<()> {
        let attributes = self.attributes.iter().map(|(name, value)| (*name, value.as_str()));
        let start = BytesStart::new(self.name).with_attributes(attributes);
        if self.children.is_empty() && self.text.is_none() {
            return writer.write_event(Event::Empty(start));
        }
        writer.write_event(Event::Start(start))?;
        if let Some(text) = &self.text {
            writer.write_event(Event::Text(BytesText::new(text)))?;
        }
        for child in &self.children {
            child.write(writer)?;
        }
        writer.write_event(Event::End(BytesEnd::new(self.name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_name_gives_a_document_that_can_be_read() {
        let name: String = (0..=0x9f).chain([0xfffe, 0xffff, 0x1_f697]).filter_map(char::from_u32).collect();
        let mut bytes = Vec::new();
        element("a").attr("b", &name).child(leaf("c", &name)).write_document(&mut bytes).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert!(text.chars().all(
            |c| matches!(c, '\t' | '\n' | '\r') || (c >= ' ' && c != '\u{7f}' && c < '\u{fffe}' || c > '\u{ffff}')
        ));
        let mut reader = quick_xml::Reader::from_str(&text);
        while reader.read_event().unwrap() != Event::Eof {}
    }

    #[test]
    fn documents_are_indented_and_escaped() {
        let root = element("a").attr("b", "1 < \"2\" & 3").child(leaf("c", "x < y")).child(element("d").attr("e", 0.5));
        let mut bytes = Vec::new();
        root.write_document(&mut bytes).unwrap();
        let expected = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
                        <a b=\"1 &lt; &quot;2&quot; &amp; 3\">\n  <c>x &lt; y</c>\n  <d e=\"0.5\"/>\n</a>\n";
        assert_eq!(String::from_utf8(bytes).unwrap(), expected);
    }
}
