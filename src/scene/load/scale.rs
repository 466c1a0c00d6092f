//! From the values of a volume file to extinction.

/// What values mean.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scale {
    /// Extinction per world unit where the density is 1.
    pub(super) sigma_t: f64,
    pub(super) density: Density,
}

/// From values to densities.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Density {
    /// Values are densities.
    Value,
    /// These two values are densities of 0 and 1, and what is outside is clamped.
    Window([f64; 2]),
    /// Points of value and density, with lines between them, and constant outside; values do not
    /// go back, and densities are at least 0.
    Curve(Vec<[f64; 2]>),
}

impl Density {
    fn of(&self, value: f64) -> f64 {
        match self {
            Self::Value => value,
            Self::Window([low, high]) => ((value - low) / (high - low)).clamp(0.0, 1.0),
            Self::Curve(points) => on_curve(points, value),
        }
    }
}

/// The density of a value; of two points at one value the last counts from there on.
fn on_curve(points: &[[f64; 2]], value: f64) -> f64 {
    let after = points.partition_point(|[x, _]| *x <= value);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some([x0, d0]), Some([x1, d1])) => d0 + (d1 - d0) * ((value - x0) / (x1 - x0)),
        (Some([_, d]), None) | (None, Some(&[_, d])) => d,
        (None, None) => 0.0,
    }
}

impl Scale {
    /// Extinction where the value is 1 and means itself.
    pub(super) fn plain(sigma_t: f64) -> Self {
        let density = Density::Value;
        Self { sigma_t, density }
    }

    pub(super) fn apply(&self, value: f32) -> f32 {
        (self.sigma_t * self.density.of(f64::from(value))) as f32
    }

    /// Whether any value from one to another has an extinction, or is one that has no business in a
    /// volume and has to be found.
    pub(super) fn counts(&self, low: f32, high: f32) -> bool {
        let counts = |value: f32| !value.is_finite() || self.apply(value) != 0.0;
        if counts(low) || counts(high) {
            return true;
        }
        // Between the ends of what rises or falls there is nothing that they are not.
        let Density::Curve(points) = &self.density else {
            return false;
        };
        let (low, high) = (f64::from(low), f64::from(high));
        points
            .iter()
            .any(|[x, d]| (low..=high).contains(x) && self.sigma_t * d != 0.0)
    }

    /// Puts extinctions in the place of values; what would be below 0 is 0.
    pub(super) fn apply_to_row(&self, row: &mut [f32]) {
        for value in row {
            let sigma_t = self.apply(*value);
            *value = if sigma_t > 0.0 { sigma_t } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_linear_between_its_points_and_constant_outside() {
        let points = vec![
            [-10.0, 0.5],
            [0.0, 0.0],
            [10.0, 4.0],
            [10.0, 1.0],
            [20.0, 0.0],
        ];
        let scale = Scale {
            sigma_t: 2.0,
            density: Density::Curve(points),
        };
        for (value, sigma_t) in [
            (-99.0, 1.0),
            (-10.0, 1.0),
            (-5.0, 0.5),
            (0.0, 0.0),
            (5.0, 4.0),
            (10.0, 2.0),
            (15.0, 1.0),
            (20.0, 0.0),
            (1e9, 0.0),
        ] {
            assert_eq!(scale.apply(value), sigma_t, "{value}");
        }
        assert!(scale.counts(f32::NAN, f32::NAN));
    }

    #[test]
    fn a_curve_of_two_points_is_a_window() {
        let [low, high] = [150.0, 1200.0];
        let scale = |density| Scale {
            sigma_t: 7.0,
            density,
        };
        let window = scale(Density::Window([low, high]));
        let curve = scale(Density::Curve(vec![[low, 0.0], [high, 1.0]]));
        for i in -100..2000 {
            let value = i as f32 * 1.03;
            assert_eq!(window.apply(value), curve.apply(value), "{value}");
        }
    }

    #[test]
    fn what_lies_between_two_empty_ends_is_found() {
        let points = vec![[10.0, 0.0], [20.0, 1.0], [30.0, 0.0]];
        let scale = Scale {
            sigma_t: 1.0,
            density: Density::Curve(points),
        };
        for (low, high, counts) in [
            (0.0, 40.0, true),
            (0.0, 10.0, false),
            (0.0, 11.0, true),
            (30.0, 90.0, false),
            (10.0, 30.0, true),
        ] {
            assert_eq!(scale.counts(low, high), counts, "{low} {high}");
        }
    }
}
