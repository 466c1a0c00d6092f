//! A description as tables: whatever a kind of file has, in the order that it is told.

use super::super::text::{bytes, count};
use crate::run::one_line;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use std::fmt::{self, Write};

/// Rows of a table, at most; the others are counted.
const MAX_ROWS: usize = 200;
/// Characters of a cell, at most.
const MAX_CELL: usize = 300;

/// A JSON value whose keys stay in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Told {
    Nothing,
    Flag(bool),
    Whole(i128),
    Number(f64),
    Text(String),
    List(Vec<Told>),
    Parts(Vec<(String, Told)>),
}

impl<'de> Deserialize<'de> for Told {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = Told;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("JSON")
            }
            fn visit_unit<E>(self) -> Result<Told, E> {
                Ok(Told::Nothing)
            }
            fn visit_bool<E>(self, v: bool) -> Result<Told, E> {
                Ok(Told::Flag(v))
            }
            fn visit_u64<E>(self, v: u64) -> Result<Told, E> {
                Ok(Told::Whole(v.into()))
            }
            fn visit_i64<E>(self, v: i64) -> Result<Told, E> {
                Ok(Told::Whole(v.into()))
            }
            fn visit_f64<E>(self, v: f64) -> Result<Told, E> {
                Ok(Told::Number(v))
            }
            fn visit_str<E>(self, v: &str) -> Result<Told, E> {
                Ok(Told::Text(v.into()))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut of: A) -> Result<Told, A::Error> {
                let mut list = Vec::new();
                while let Some(v) = of.next_element()? {
                    list.push(v);
                }
                Ok(Told::List(list))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut of: A) -> Result<Told, A::Error> {
                let mut parts = Vec::new();
                while let Some(part) = of.next_entry()? {
                    parts.push(part);
                }
                Ok(Told::Parts(parts))
            }
        }
        from.deserialize_any(Any)
    }
}

impl Told {
    fn is_empty(&self) -> bool {
        match self {
            Self::Nothing => true,
            Self::List(l) => l.is_empty(),
            Self::Parts(p) => p.is_empty(),
            _ => false,
        }
    }

    /// Whether it has a table of its own.
    fn is_table(&self) -> bool {
        match self {
            Self::Parts(_) => self.histogram().is_none(),
            Self::List(list) => list.iter().any(|v| {
                matches!(v, Self::Parts(_)) || v.pair().is_some() || matches!(v, Self::Text(_))
            }),
            _ => false,
        }
    }

    /// A name with its value.
    fn pair(&self) -> Option<(&str, &Told)> {
        match self {
            Self::List(list) => match &list[..] {
                [Self::Text(name), value @ Self::Text(_)] => Some((name, value)),
                _ => None,
            },
            _ => None,
        }
    }

    /// The ends and counts of a histogram.
    fn histogram(&self) -> Option<(f64, f64, Vec<f64>)> {
        let Self::Parts(parts) = self else {
            return None;
        };
        match &parts[..] {
            [(a, from), (b, to), (c, Self::List(counts))]
                if (a.as_str(), b.as_str(), c.as_str()) == ("from", "to", "counts") =>
            {
                let counts: Option<Vec<f64>> = counts.iter().map(Self::number).collect();
                Some((from.number()?, to.number()?, counts?))
            }
            _ => None,
        }
    }

    fn number(&self) -> Option<f64> {
        match self {
            Self::Whole(v) => Some(*v as f64),
            Self::Number(v) => Some(*v),
            _ => None,
        }
    }

    /// As it stands in a cell.
    fn inline(&self) -> String {
        let joined = |parts: Vec<String>| parts.join(", ");
        match self {
            Self::Nothing => "–".into(),
            Self::Flag(v) => if *v { "yes" } else { "no" }.into(),
            Self::Whole(v) => whole(*v),
            Self::Number(v) => number(*v),
            Self::Text(v) => one_line(v),
            Self::List(l) if l.is_empty() => "none".into(),
            Self::List(l) => joined(l.iter().map(Self::within).collect()),
            Self::Parts(p) => joined(
                p.iter()
                    .map(|(name, v)| format!("{} {}", words(name), v.within()))
                    .collect(),
            ),
        }
    }

    /// The same inside a list.
    fn within(&self) -> String {
        match self {
            Self::List(l) if !l.is_empty() => format!("({})", self.inline()),
            _ => self.inline(),
        }
    }
}

fn whole(v: i128) -> String {
    let digits = count(u64::try_from(v.unsigned_abs()).unwrap_or(u64::MAX));
    if v < 0 { format!("-{digits}") } else { digits }
}

/// With nine digits, as many as a 32-bit float has.
fn number(v: f64) -> String {
    let v: f64 = format!("{v:.8e}").parse().unwrap_or(v);
    if v == 0.0 || (1e-4..1e7).contains(&v.abs()) {
        v.to_string()
    } else {
        format!("{v:e}")
    }
}

/// A key as words.
fn words(key: &str) -> String {
    one_line(key.replace('_', " "))
}

/// Text as HTML, of any origin.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            _ => out.push(c),
        }
    }
    out
}

fn cut(text: String) -> String {
    match text.char_indices().nth(MAX_CELL) {
        Some((at, _)) => text[..at].to_owned() + "…",
        None => text,
    }
}

/// A cell of a table, as HTML.
fn cell(name: &str, value: &Told) -> String {
    if let Some(histogram) = value.histogram() {
        return bars(&histogram);
    }
    let is_bytes = name == "bytes" || name.ends_with("_bytes");
    let text = match value {
        Told::Whole(v) if is_bytes && *v >= 1024 => {
            let short = bytes(u64::try_from(*v).unwrap_or(u64::MAX));
            format!("{} ({short})", whole(*v))
        }
        _ => value.inline(),
    };
    let is_code = name.ends_with("hash") && matches!(value, Told::Text(_));
    let text = escape(&cut(text));
    if is_code {
        format!("<code>{text}</code>")
    } else {
        text
    }
}

/// A histogram as a picture.
fn bars((from, to, counts): &(f64, f64, Vec<f64>)) -> String {
    let most = counts.iter().copied().fold(1.0, f64::max);
    let mut path = String::new();
    for (i, c) in counts.iter().take(512).enumerate() {
        // Where it is not 0 it is seen.
        let height = if *c > 0.0 {
            (c / most).sqrt() * 39.0 + 1.0
        } else {
            0.0
        };
        let _ = write!(path, "M{} 40v-{height:.1}", i * 4 + 2);
    }
    let width = counts.len().min(512) * 4;
    let (from, to) = (number(*from), number(*to));
    format!(
        "{from} <svg class=\"bars\" viewBox=\"0 0 {width} 40\" width=\"{width}\" height=\"40\" \
         role=\"img\" aria-label=\"histogram from {from} to {to}, heights by square root\">\
         <path d=\"{path}\"/></svg> {to}"
    )
}

/// All tables of a description; its warnings come first.
pub fn tables(told: &Told) -> String {
    let mut html = String::new();
    if let Told::Parts(parts) = told {
        let warnings = parts.iter().find(|(name, _)| name == "warnings");
        if let Some((name, warnings)) = warnings.filter(|(_, w)| !w.is_empty()) {
            section(&words(name), warnings, &mut html);
        }
        let others: Vec<_> = parts.iter().filter(|(n, _)| n != "warnings").collect();
        parts_of("File", &others, &mut html);
    }
    html
}

fn section(title: &str, value: &Told, html: &mut String) {
    match value {
        Told::Parts(parts) => parts_of(title, &parts.iter().collect::<Vec<_>>(), html),
        Told::List(list) if list.iter().all(|v| v.pair().is_some()) => {
            let rows = list.iter().filter_map(Told::pair);
            let rows: Vec<_> = rows.map(|(n, v)| (one_line(n), cell(n, v))).collect();
            two_columns(title, &rows, html);
        }
        Told::List(list) if list.iter().any(|v| matches!(v, Told::Parts(_))) => {
            columns(title, list, html);
        }
        Told::List(list) => {
            let _ = write!(html, "<section>\n<h3>{}</h3>\n<ul>\n", escape(title));
            for v in list.iter().take(MAX_ROWS) {
                let _ = writeln!(html, "<li>{}</li>", cell("", v));
            }
            *html += "</ul>\n";
            more(list.len(), html);
            *html += "</section>\n";
        }
        _ => {}
    }
}

/// What has values by name: these as one table, and what has tables of its own after it.
fn parts_of(title: &str, parts: &[&(String, Told)], html: &mut String) {
    let is_own = |v: &Told| !v.is_empty() && v.is_table() && !is_small(v);
    let rows: Vec<(String, String)> = parts
        .iter()
        .filter(|(_, v)| !is_own(v))
        .map(|(name, v)| (words(name), cell(name, v)))
        .collect();
    if !rows.is_empty() {
        two_columns(title, &rows, html);
    }
    for (name, v) in parts.iter().filter(|(_, v)| is_own(v)) {
        let title = match title {
            "File" => words(name),
            _ => format!("{title}: {}", words(name)),
        };
        section(&title, v, html);
    }
}

/// Whether its parts fit one cell.
fn is_small(v: &Told) -> bool {
    match v {
        Told::Parts(parts) => {
            parts.len() <= 3 && parts.iter().all(|(_, v)| v.number().is_some() || matches!(v, Told::List(l) if l.len() <= 3 && l.iter().all(|v| v.number().is_some())))
        }
        _ => false,
    }
}

fn two_columns(title: &str, rows: &[(String, String)], html: &mut String) {
    let _ = write!(
        html,
        "<section>\n<h3>{}</h3>\n<div class=\"wide\"><table class=\"pairs\">\n",
        escape(title)
    );
    for (name, cell) in rows.iter().take(MAX_ROWS) {
        let name = escape(&cut(name.clone()));
        let _ = writeln!(
            html,
            "<tr><th scope=\"row\">{name}</th><td>{cell}</td></tr>"
        );
    }
    *html += "</table></div>\n";
    more(rows.len(), html);
    *html += "</section>\n";
}

/// Rows that have the same parts.
fn columns(title: &str, list: &[Told], html: &mut String) {
    let shown = &list[..list.len().min(MAX_ROWS)];
    let mut names: Vec<&str> = Vec::new();
    for row in shown {
        if let Told::Parts(parts) = row {
            for (name, _) in parts {
                if !names.contains(&name.as_str()) {
                    names.push(name);
                }
            }
        }
    }
    let numbered = list.len() > 1 && title.ends_with("levels") && !names.contains(&"level");
    let _ = write!(
        html,
        "<section>\n<h3>{}</h3>\n<div class=\"wide\"><table>\n<tr>",
        escape(title)
    );
    if numbered {
        *html += "<th scope=\"col\">level</th>";
    }
    for name in &names {
        let _ = write!(html, "<th scope=\"col\">{}</th>", escape(&words(name)));
    }
    *html += "</tr>\n";
    for (i, row) in shown.iter().enumerate() {
        *html += "<tr>";
        if numbered {
            let _ = write!(html, "<td class=\"n\">{i}</td>");
        }
        for name in &names {
            let value = match row {
                Told::Parts(parts) => parts.iter().find(|(n, _)| n == name).map(|(_, v)| v),
                _ => None,
            };
            let class = match value {
                Some(Told::Whole(_) | Told::Number(_)) => " class=\"n\"",
                _ => "",
            };
            let cell = value.map_or(String::new(), |v| cell(name, v));
            let _ = write!(html, "<td{class}>{cell}</td>");
        }
        *html += "</tr>\n";
    }
    *html += "</table></div>\n";
    more(list.len(), html);
    *html += "</section>\n";
}

/// Says how many rows are not shown.
fn more(rows: usize, html: &mut String) {
    if rows > MAX_ROWS {
        let left = count((rows - MAX_ROWS) as u64);
        let _ = writeln!(
            html,
            "<p class=\"note\">and {left} more, which <code>--json</code> has</p>"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(json: &str) -> Told {
        serde_json::from_str(json).unwrap()
    }

    #[test]
    fn all_that_is_told_has_a_place() {
        let html = tables(&told(
            r#"{"z": 1234567, "a": 0.1, "stored_bytes": 2048, "content_hash": "ab", "volumes": [],
                "sums": {"area": 1.5, "flux": [1, 2, 3], "x": null, "y": true},
                "settings": [["surfels", "7"], ["spp", "<b>"]],
                "levels": [{"nodes": 1, "name": "a\nb"}, {"nodes": 2}],
                "values": {"from": 0, "to": 2, "counts": [1, 0, 5]},
                "warnings": ["a & b"]}"#,
        ));
        let order = [
            "a &amp; b",
            "1,234,567",
            "0.1",
            "2,048 (2.0 KiB)",
            "<code>ab</code>",
            "none",
        ];
        let mut at = 0;
        for part in order {
            at += html[at..]
                .find(part)
                .unwrap_or_else(|| panic!("{part}: {html}"));
        }
        for part in [
            "<h3>sums</h3>",
            "1, 2, 3",
            "<td>yes</td>",
            "<th scope=\"row\">spp</th><td>&lt;b&gt;</td>",
            "<h3>levels</h3>",
            "a\\nb",
            "histogram from 0 to 2",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
    }

    #[test]
    fn long_lists_and_texts_are_cut() {
        let rows = vec![r#"{"a": 1}"#; 1000].join(",");
        let html = tables(&told(&format!(
            r#"{{"rows": [{rows}], "t": "{}"}}"#,
            "x".repeat(900)
        )));
        assert!(html.contains("and 800 more") && html.contains("x…"));
        assert_eq!(html.matches("<tr>").count(), 202);
    }

    #[test]
    fn numbers_are_short() {
        for (v, text) in [
            (0.1 + 0.2, "0.3"),
            (1.0, "1"),
            (12345678.0, "1.2345678e7"),
            (-1e-9, "-1e-9"),
            (f64::from(0.1_f32), "0.100000001"),
        ] {
            assert_eq!(number(v), text);
        }
        assert_eq!(whole(-1234), "-1,234");
    }
}
