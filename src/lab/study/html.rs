//! The report of a study: one HTML file with all in it.

use super::plots::Plot;
use super::record::Study;
use super::table::{self, Table};
use crate::image::heat;
use std::fmt::Write;

/// An image of the report.
pub struct Shown {
    /// What it is.
    pub caption: String,
    /// The image, a PNG file.
    pub png: Vec<u8>,
    /// Its errors as a heat map, a PNG file.
    pub heat: Option<Vec<u8>>,
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;\
    padding:0 1em;color:#222}\
    table{border-collapse:collapse;margin:1em 0;font-size:.85em}\
    td,th{padding:.3em .7em;border-bottom:1px solid #ddd;text-align:right}\
    td:first-child,th:first-child{text-align:left}\
    th{border-bottom:2px solid #888;vertical-align:bottom}\
    div.wide{overflow-x:auto}th{max-width:9em}td{white-space:nowrap}\
    figure{margin:0 0 1em}.pair{display:flex;gap:.5em}.pair img{width:50%}\
    .bar span{display:inline-block;width:16em;height:1em;vertical-align:middle}\
    figcaption,.bar{font-size:.9em}svg{max-width:100%;height:auto}";

/// The whole file.
pub fn report(study: &Study, plots: &[Plot], images: &[Shown]) -> String {
    let title = escape(&study.scene);
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}: error against run time</title><style>{STYLE}</style></head>\n<body>\n\
         <h1>{title}: error against run time</h1>\n<p>{}</p>\n",
        escape(&table::caption(study))
    );
    let mut section = |title: &str, body: &str| {
        let _ = write!(html, "<h2>{title}</h2>\n{body}\n");
    };
    for plot in plots {
        section(plot.title, &plot.svg);
    }
    for (title, table) in table::tables(study) {
        let note = match title == table::SETTINGS {
            true => format!("<p>{}</p>\n", table::SLOPES),
            false => String::new(),
        };
        section(title, &(note + &to_html(&table)));
    }
    let figures: String = images.iter().map(figure).collect();
    section(
        "Images and their FLIP errors",
        &format!("<p class=\"bar\">FLIP 0 {} 1</p>\n{figures}", scale()),
    );
    html + "</body></html>\n"
}

fn picture(png: &[u8], alt: &str) -> String {
    let data = base64::encode(png);
    format!("<img alt=\"{alt}\" src=\"data:image/png;base64,{data}\">")
}

/// The colours of the heat maps.
fn scale() -> String {
    let stops = heat::map(&[0.0, 0.2, 0.4, 0.6, 0.8, 1.0], 6).pixels;
    let stops: Vec<String> = stops
        .iter()
        .map(|[r, g, b]| format!("rgb({r},{g},{b})"))
        .collect();
    let stops = stops.join(",");
    format!("<span style=\"background:linear-gradient(90deg,{stops})\"></span>")
}

fn figure(image: &Shown) -> String {
    let caption = escape(&image.caption);
    let heat = image.heat.as_ref().map_or(String::new(), |heat| {
        picture(heat, &format!("FLIP error of {caption}"))
    });
    format!(
        "<figure><div class=\"pair\">{}{heat}</div><figcaption>{caption}</figcaption></figure>\n",
        picture(&image.png, &caption)
    )
}

fn to_html(table: &Table) -> String {
    let cells = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
        let cells: String = cells
            .map(|c| format!("<{tag}>{}</{tag}>", escape(c)))
            .collect();
        format!("<tr>{cells}</tr>\n")
    };
    let mut html = String::from("<div class=\"wide\"><table>\n");
    html += &cells("th", &mut table.head.iter().copied());
    for row in &table.rows {
        html += &cells("td", &mut row.iter().map(String::as_str));
    }
    html + "</table></div>\n"
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out() {
        let study = Study {
            scene: "<script>alert(\"x\")</script>".into(),
            ..Study::default()
        };
        assert!(!report(&study, &[], &[]).contains("<script"));
    }
}
