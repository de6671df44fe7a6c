//! Text from outside (names, descriptions) in files of other programs.

use std::borrow::Cow;

use crate::shown;

/// A string literal of Python, JSON and pbrt, with its quotes.
pub fn literal(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// A comment of XML, which may hold no two hyphens in a row and no control character.
pub fn xml_comment(text: &str) -> String {
    let mut comment = String::from("<!-- ");
    for c in of_xml(text).chars() {
        if c == '-' && comment.ends_with('-') {
            comment.push(' ');
        }
        comment.push(c);
    }
    comment + " -->"
}

/// The value of an XML attribute, without its quotes.
pub fn xml_value(text: &str) -> String {
    let mut value = String::new();
    for c in of_xml(text).chars() {
        match c {
            '&' => value += "&amp;",
            '<' => value += "&lt;",
            '>' => value += "&gt;",
            '"' => value += "&quot;",
            c => value.push(c),
        }
    }
    value
}

/// Without what XML 1.0 allows nowhere, not even escaped.
fn of_xml(text: &str) -> Cow<'_, str> {
    let is_none = |c| matches!(c, '\u{fffe}' | '\u{ffff}');
    match shown::escaped(text) {
        text if text.contains(is_none) => text.replace(is_none, "\u{fffd}").into(),
        text => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_text_stays_text() {
        for (text, comment) in [
            ("red---v2", "<!-- red- - -v2 -->"),
            ("x---> <a/> <!--", "<!-- x- - -> <a/> <!- - -->"),
            ("-", "<!-- - -->"),
            ("a\u{1}\nb\u{ffff}", "<!-- a\\u{1}\\nb\u{fffd} -->"),
            ("Größe", "<!-- Größe -->"),
        ] {
            assert_eq!(xml_comment(text), comment);
        }
        assert_eq!(xml_value("a\"<&>\u{7}"), "a&quot;&lt;&amp;&gt;\\u{7}");
        assert_eq!(literal("a\"\\\n赤"), "\"a\\\"\\\\\\n赤\"");
    }
}
