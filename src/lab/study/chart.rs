//! A chart with two logarithmic axes, as SVG. The legend stands beside it and covers no point.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;

/// A point, with what is known of its spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Along the first axis.
    pub x: f64,
    /// Along the second.
    pub y: f64,
    /// Ends of a bar along the second.
    pub bar: Option<[f64; 2]>,
    /// Whether it is no more than a bound: its disk is hollow.
    pub is_bound: bool,
}

/// Points of one colour.
#[derive(Clone, Debug)]
pub struct Series {
    /// What the legend says.
    pub label: String,
    /// Of its points and its line.
    pub color: RGBColor,
    /// Its points.
    pub marks: Vec<Mark>,
    /// Whether a line joins them.
    pub joined: bool,
    /// Whether they are triangles, not disks.
    pub is_foreign: bool,
    /// Name of each point, told in the legend by its number; empty for none.
    pub names: Vec<String>,
}

/// Why a chart cannot be drawn.
pub type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Plane<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<LogCoord<f64>, LogCoord<f64>>>;
type Place = (i32, i32);

const GREY: RGBColor = RGBColor(170, 170, 170);
const BAND: RGBColor = RGBColor(238, 238, 238);
/// Of the chart without its legend.
const WIDTH: u32 = 680;
const HEIGHT: u32 = 460;
/// Of an entry of the legend.
const ROW: i32 = 20;
const RADIUS: i32 = 4;
/// Letters of the longest entry of a legend; the rest of it is left out.
const MAX_LETTERS: usize = 44;
/// Height of a number beside a point, and width of one of its digits.
const NUMBER: [i32; 2] = [13, 8];

/// Whether a value has a place on an axis of logarithms.
pub fn has_place(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// What stands in the legend.
enum Entry<'a> {
    Series(&'a Series),
    Number(RGBColor, usize, &'a str),
    Noise,
}

impl Entry<'_> {
    fn text(&self) -> String {
        let text = match self {
            Self::Series(series) => &series.label,
            Self::Number(_, _, name) => *name,
            Self::Noise => "below the noise of the reference",
        };
        match text.chars().count() > MAX_LETTERS {
            true => text.chars().take(MAX_LETTERS - 1).chain(['…']).collect(),
            false => text.into(),
        }
    }
}

/// Draws series, and a band up to a level below which nothing can be told.
///
/// # Errors
/// What the drawing library says.
pub fn draw(axes: [&str; 2], series: &[Series], noise: Option<f64>) -> Result<String, Failure> {
    let marks = series.iter().flat_map(|s| &s.marks);
    let x = range(marks.clone().map(|m| m.x));
    let heights = marks.flat_map(|m| m.bar.unwrap_or([m.y; 2]).into_iter().chain([m.y]));
    let y = range(heights.chain(noise));
    let shown: Vec<&Series> = series.iter().filter(|s| !s.marks.is_empty()).collect();
    let legend = legend(&shown, noise.is_some());
    let letters = legend.iter().map(|e| e.text().chars().count()).max();
    let width = WIDTH + 40 + 8 * letters.unwrap_or(0) as u32;
    let height = HEIGHT.max(40 + ROW as u32 * legend.len() as u32);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
        area.fill(&WHITE)?;
        let (left, right) = area.split_horizontally(WIDTH);
        let (left, _) = left.split_vertically(HEIGHT);
        let mut plane = ChartBuilder::on(&left)
            .margin(14)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(x.clone().log_scale(), y.clone().log_scale())?;
        if let Some(level) = noise {
            let corners = [(x.start, y.start), (x.end, level)];
            plane.draw_series([Rectangle::new(corners, BAND.filled())])?;
        }
        plane
            .configure_mesh()
            .disable_mesh()
            .set_all_tick_mark_size(0)
            .x_label_formatter(&|_| String::new())
            .y_label_formatter(&|_| String::new())
            .x_desc(axes[0])
            .y_desc(axes[1])
            .label_style(("sans-serif", 14))
            .draw()?;
        draw_grid(&left, &plane, &x, &y)?;
        if let Some(level) = noise {
            let ends = vec![(x.start, level), (x.end, level)];
            plane.draw_series([PathElement::new(ends, GREY)])?;
        }
        draw_series(&left, &plane, &shown)?;
        for (row, entry) in (0..).zip(&legend) {
            draw_entry(&right, entry, 20 + ROW * row)?;
        }
        area.present()?;
    }
    Ok(svg)
}

fn legend<'a>(series: &[&'a Series], has_noise: bool) -> Vec<Entry<'a>> {
    let mut entries: Vec<Entry> = Vec::new();
    for &series in series {
        entries.push(Entry::Series(series));
        let names = series.names.iter().enumerate();
        entries.extend(names.map(|(i, name)| Entry::Number(series.color, i + 1, name)));
    }
    if has_noise {
        entries.push(Entry::Noise);
    }
    entries
}

fn draw_entry(area: &Area<'_>, entry: &Entry, down: i32) -> Result<(), Failure> {
    match entry {
        Entry::Series(series) => draw_mark(area, (12, down), series, false)?,
        Entry::Number(color, number, _) => area.draw(&Text::new(
            number.to_string(),
            (12, down),
            text(13, *color, HPos::Center, VPos::Center),
        ))?,
        Entry::Noise => {
            let corners = [(4, down - 6), (20, down + 6)];
            area.draw(&Rectangle::new(corners, BAND.filled()))?;
            area.draw(&Rectangle::new(corners, GREY))?;
        }
    }
    let style = text(14, BLACK, HPos::Left, VPos::Center);
    area.draw(&Text::new(entry.text(), (28, down), style))?;
    Ok(())
}

fn text(size: i32, color: RGBColor, h: HPos, v: VPos) -> TextStyle<'static> {
    let style = ("sans-serif", size).into_font().color(&color);
    style.pos(Pos::new(h, v))
}

fn draw_mark(area: &Area<'_>, at: Place, series: &Series, is_bound: bool) -> Result<(), Failure> {
    let style = match is_bound {
        true => series.color.stroke_width(1),
        false => series.color.filled(),
    };
    match series.is_foreign {
        true => area.draw(&TriangleMarker::new(at, RADIUS + 2, style))?,
        false => area.draw(&Circle::new(at, RADIUS, style))?,
    }
    Ok(())
}

/// Draws lines, bars and points of all series, and then the numbers of points that have names,
/// where they cover no point and no other number.
fn draw_series(area: &Area<'_>, plane: &Plane<'_>, series: &[&Series]) -> Result<(), Failure> {
    let on_page = |x: f64, y: f64| plane.plotting_area().map_coordinate(&(x, y));
    let mut taken: Vec<[i32; 4]> = Vec::new();
    for s in series {
        let line: Vec<Place> = s.marks.iter().map(|m| on_page(m.x, m.y)).collect();
        if s.joined {
            area.draw(&PathElement::new(line.clone(), s.color.stroke_width(2)))?;
        }
        for (mark, &at) in s.marks.iter().zip(&line) {
            if let Some([low, high]) = mark.bar {
                let [low, high] = [low, high].map(|y| on_page(mark.x, y).1);
                for ends in [
                    [(at.0, low), (at.0, high)],
                    [(at.0 - 4, low), (at.0 + 4, low)],
                    [(at.0 - 4, high), (at.0 + 4, high)],
                ] {
                    area.draw(&PathElement::new(ends.to_vec(), s.color))?;
                }
            }
            draw_mark(area, at, s, mark.is_bound)?;
            taken.push(around(at, [2 * RADIUS; 2]));
        }
        if s.joined && !s.names.is_empty() {
            taken.extend(line.windows(2).flat_map(|ends| along(ends[0], ends[1])));
        }
    }
    let (across, down) = plane.plotting_area().get_pixel_range();
    let inside = [across.start, down.start, across.end, down.end];
    for s in series {
        for (i, mark) in (0..s.names.len()).zip(&s.marks) {
            let number = (i + 1).to_string();
            let at = on_page(mark.x, mark.y);
            let size = [NUMBER[1] * number.len() as i32, NUMBER[0]];
            let middle = free_place(at, size, inside, &taken);
            taken.push(around(middle, size));
            let style = text(13, s.color, HPos::Center, VPos::Center);
            area.draw(&Text::new(number, middle, style))?;
        }
    }
    Ok(())
}

fn around((x, y): Place, [width, height]: [i32; 2]) -> [i32; 4] {
    [
        x - width / 2,
        y - height / 2,
        x - width / 2 + width,
        y - height / 2 + height,
    ]
}

/// Small boxes that cover a line.
fn along(from: Place, to: Place) -> impl Iterator<Item = [i32; 4]> {
    const STEP: i32 = 4;
    let (across, down) = (to.0 - from.0, to.1 - from.1);
    let steps = (across.abs().max(down.abs()) / STEP).max(1);
    let at = move |i| (from.0 + across * i / steps, from.1 + down * i / steps);
    (0..=steps).map(move |i| around(at(i), [STEP; 2]))
}

/// The middle of a box beside a point that is inside a chart and meets nothing that is there, the
/// nearest of some; above the point if there is none.
fn free_place((x, y): Place, size: [i32; 2], inside: [i32; 4], taken: &[[i32; 4]]) -> Place {
    const WAYS: [Place; 8] = [
        (1, -1),
        (0, -1),
        (1, 0),
        (-1, -1),
        (1, 1),
        (0, 1),
        (-1, 1),
        (-1, 0),
    ];
    let meets =
        |a: &[i32; 4], b: &[i32; 4]| a[0] <= b[2] && b[0] <= a[2] && a[1] <= b[3] && b[1] <= a[3];
    let places = (0..6).flat_map(|ring| {
        let away = [0, 1].map(|a| RADIUS + size[a] / 2 + 2 + 7 * ring);
        WAYS.map(|(right, down)| (x + right * away[0], y + down * away[1]))
    });
    let is_free = |place: &Place| {
        let own = around(*place, size);
        let within =
            own[0] > inside[0] && own[1] > inside[1] && own[2] < inside[2] && own[3] < inside[3];
        within && !taken.iter().any(|other| meets(&own, other))
    };
    places
        .into_iter()
        .find(is_free)
        .unwrap_or((x, y - RADIUS - size[1] / 2 - 2))
}

/// All values that have a place on an axis, with some room around them; around 1 if none has.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let ends = values.filter(|&v| has_place(v)).fold(None, |ends, v| {
        let (low, high) = ends.unwrap_or((v, v));
        Some((v.min(low), v.max(high)))
    });
    let (low, high) = ends.unwrap_or((1.0, 1.0));
    // Neither end may leave what a number can hold.
    (low * 0.7).max(f64::MIN_POSITIVE)..(high * 1.4).min(f64::MAX)
}

/// Round values inside a range and their names, few enough to stand beside each other.
fn ticks(range: &Range<f64>) -> Vec<(f64, String)> {
    let decades = range.start.log10().floor() as i32..=range.end.log10().floor() as i32;
    let among = |digits: &[u8]| -> Vec<(f64, String)> {
        let all = decades.clone().flat_map(|k| {
            digits.iter().filter_map(move |digit| {
                let name = format!("{digit}e{k}");
                let value: f64 = name.parse().ok()?;
                let plain = (-3..=6).contains(&k);
                Some((value, if plain { value.to_string() } else { name }))
            })
        });
        all.filter(|t| range.contains(&t.0)).collect()
    };
    let (wide, middle) = (among(&[1]), among(&[1, 2, 5]));
    if wide.len() > 3 {
        wide
    } else if middle.len() > 2 {
        middle
    } else {
        among(&[1, 2, 3, 4, 5, 6, 7, 8, 9])
    }
}

fn grid(ends: [Place; 2]) -> PathElement<Place> {
    PathElement::new(ends.to_vec(), RGBColor(228, 228, 228))
}

/// Draws lines at round values across the plot, and the values beside the axes.
fn draw_grid(
    area: &Area<'_>,
    plane: &Plane<'_>,
    x: &Range<f64>,
    y: &Range<f64>,
) -> Result<(), Failure> {
    let (across, down) = plane.plotting_area().get_pixel_range();
    for (value, name) in ticks(x) {
        let (at, _) = plane.plotting_area().map_coordinate(&(value, y.start));
        area.draw(&grid([(at, down.start), (at, down.end)]))?;
        let below = (at, down.end + 6);
        area.draw(&Text::new(
            name,
            below,
            text(14, BLACK, HPos::Center, VPos::Top),
        ))?;
    }
    for (value, name) in ticks(y) {
        let (_, at) = plane.plotting_area().map_coordinate(&(x.start, value));
        area.draw(&grid([(across.start, at), (across.end, at)]))?;
        let beside = (across.start - 6, at);
        area.draw(&Text::new(
            name,
            beside,
            text(14, BLACK, HPos::Right, VPos::Center),
        ))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_of_what_has_a_place_on_an_axis() {
        let none = [0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        let of = |values: &[f64]| range(values.iter().copied());
        assert_eq!(of(&[2.0, 10.0]), 1.4..14.0);
        for odd in none {
            assert_eq!(of(&[2.0, odd, 10.0]), 1.4..14.0, "{odd}");
        }
        assert_eq!(of(&none), 0.7..1.4);
        assert_eq!(of(&[]), 0.7..1.4);
        let widest = of(&[f64::MIN_POSITIVE, f64::MAX]);
        assert!(widest.start > 0.0 && widest.end.is_finite());
    }

    #[test]
    fn lines_are_covered_from_end_to_end() {
        for (from, to) in [((0, 0), (90, 7)), ((50, 80), (48, -30)), ((3, 3), (3, 3))] {
            let boxes: Vec<_> = along(from, to).collect();
            let holds =
                |b: &[i32; 4], p: Place| b[0] <= p.0 && p.0 <= b[2] && b[1] <= p.1 && p.1 <= b[3];
            for i in 0..=100 {
                let p = (
                    from.0 + (to.0 - from.0) * i / 100,
                    from.1 + (to.1 - from.1) * i / 100,
                );
                assert!(boxes.iter().any(|b| holds(b, p)), "{from:?} {to:?} {p:?}");
            }
        }
    }

    #[test]
    fn numbers_find_a_place_of_their_own() {
        let inside = [0, 0, 400, 300];
        let points = [(100, 100), (104, 102), (108, 98), (4, 4), (398, 296)];
        let box_of = |(x, y): Place| [x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS];
        let mut taken: Vec<[i32; 4]> = points.map(box_of).to_vec();
        for point in points {
            let own = around(free_place(point, [16, 13], inside, &taken), [16, 13]);
            assert!(
                own[0] > 0 && own[1] > 0 && own[2] < 400 && own[3] < 300,
                "{own:?}"
            );
            for other in &taken {
                let apart = own[0] > other[2]
                    || other[0] > own[2]
                    || own[1] > other[3]
                    || other[1] > own[3];
                assert!(apart, "{own:?} {other:?}");
            }
            taken.push(own);
        }
        // Nowhere else: above the point.
        assert_eq!(free_place((5, 50), [16, 13], [0; 4], &[]), (5, 38));
    }

    #[test]
    fn axes_have_a_few_round_marks() {
        let names = |range| -> Vec<String> { ticks(&range).into_iter().map(|t| t.1).collect() };
        assert_eq!(names(0.03..4.0), ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
        assert_eq!(names(5e-6..0.2), ["1e-5", "1e-4", "0.001", "0.01", "0.1"]);
        assert_eq!(names(0.91..1.9), ["1"]);
        assert_eq!(names(2.1..4.5), ["3", "4"]);
        assert_eq!(names(1e5..2e6), ["100000", "200000", "500000", "1000000"]);
    }
}
