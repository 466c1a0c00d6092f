//! Names beside the points of a plot, placed so that none covers another or a point.

/// Height of a line of text, pixels.
pub const LINE: i32 = 16;

/// A rectangle of pixels, right and bottom excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// Left edge, pixels from the left of the picture.
    pub left: i32,
    /// Upper edge, pixels from the top of the picture.
    pub top: i32,
    /// Pixels from the left edge to the right one.
    pub width: i32,
    /// Pixels from the upper edge to the lower one.
    pub height: i32,
}

impl Rect {
    /// The box of a name with its upper left corner at a place; text of this size is at most this
    /// wide.
    fn of_text(name: &str, left: i32, top: i32) -> Self {
        Self {
            left,
            top,
            width: 15 * name.chars().count() as i32 / 2,
            height: LINE,
        }
    }

    fn around(point: (i32, i32)) -> Self {
        Self {
            left: point.0 - 5,
            top: point.1 - 5,
            width: 10,
            height: 10,
        }
    }

    /// Whether two share a pixel.
    #[must_use]
    pub fn meets(&self, other: &Self) -> bool {
        self.left < other.left + other.width
            && other.left < self.left + self.width
            && self.top < other.top + other.height
            && other.top < self.top + self.height
    }

    fn holds(&self, other: &Self) -> bool {
        self.left <= other.left
            && self.top <= other.top
            && other.left + other.width <= self.left + self.width
            && other.top + other.height <= self.top + self.height
    }
}

/// Boxes for names near their points inside an area. A name that fits nowhere gets none.
#[must_use]
pub fn place(
    points: &[(i32, i32)],
    names: &[String],
    area: Rect,
    taken: &[Rect],
) -> Vec<Option<Rect>> {
    let mut blocked: Vec<Rect> = points.iter().map(|&p| Rect::around(p)).collect();
    blocked.extend(taken);
    points
        .iter()
        .zip(names)
        .map(|(&(x, y), name)| {
            // A front falls from the left to the right: above at the right and below at the left
            // are off its line.
            let width = Rect::of_text(name, 0, 0).width;
            let (right, left) = (x + 9, x - 9 - width);
            let found = (0..area.height / LINE).find_map(|step| {
                let (above, below) = (y - 2 - (step + 1) * LINE, y + 3 + step * LINE);
                [(right, above), (left, below), (right, below), (left, above)]
                    .into_iter()
                    .map(|(left, top)| Rect::of_text(name, left, top))
                    .find(|r| area.holds(r) && !blocked.iter().any(|b| b.meets(r)))
            });
            blocked.extend(found);
            found
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Rect = Rect {
        left: 50,
        top: 10,
        width: 600,
        height: 400,
    };

    #[test]
    fn names_of_close_points_keep_apart() {
        let points: Vec<(i32, i32)> = (0..12).map(|i| (300 + 3 * i, 200 - i)).collect();
        let names: Vec<String> = (0..12).map(|i| format!("extended-samples-{i}")).collect();
        let legend = Rect {
            left: 400,
            top: 10,
            width: 250,
            height: 60,
        };
        let boxes: Vec<Rect> = place(&points, &names, AREA, &[legend])
            .into_iter()
            .map(Option::unwrap)
            .collect();
        for (i, a) in boxes.iter().enumerate() {
            assert!(AREA.holds(a) && !a.meets(&legend));
            assert!(boxes[..i].iter().all(|b| !a.meets(b)));
            assert!(points.iter().all(|&p| !a.meets(&Rect::around(p))));
        }
    }

    #[test]
    fn a_lone_name_stands_beside_its_point_and_at_the_border_to_its_left() {
        let [right, left] =
            [(100, 100), (640, 100)].map(|p| place(&[p], &["base".into()], AREA, &[])[0].unwrap());
        assert_eq!((right.left, right.top), (109, 82));
        assert!(left.left + left.width < 640);
    }

    #[test]
    fn what_fits_nowhere_is_left_out() {
        let name = "x".repeat(1000);
        assert_eq!(place(&[(100, 100)], &[name], AREA, &[]), [None]);
    }
}
