//! One checked number, and the table that they make.

use std::fmt::Write;

/// A case at one parameter: what came out beside what had to.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Row {
    /// What was looked at.
    pub case: String,
    /// The value that the case was tried at, and its name.
    pub parameter: String,
    /// The closed form, quadrature, or bound.
    pub expected: f64,
    /// The value that lvox gave, in the unit of `expected`.
    pub got: f64,
    /// Relative error of `got`; where 0 was expected, its size.
    pub error: f64,
    /// The error that is allowed.
    pub limit: f64,
}

impl Row {
    /// `got` against `expected`, which is not 0.
    pub fn relative(
        case: impl Into<String>,
        parameter: impl Into<String>,
        expected: f64,
        got: f64,
        limit: f64,
    ) -> Self {
        let error = (got - expected).abs() / expected.abs();
        Self::with_error(case, parameter, (expected, got), error, limit)
    }

    /// `got` where there should be nothing.
    pub fn nothing(
        case: impl Into<String>,
        parameter: impl Into<String>,
        got: f64,
        limit: f64,
    ) -> Self {
        Self::with_error(case, parameter, (0.0, got), got.abs(), limit)
    }

    /// How many of a number of trials broke a rule; none may.
    pub fn count(case: impl Into<String>, parameter: impl Into<String>, broken: usize) -> Self {
        Self::nothing(case, parameter, broken as f64, 0.0)
    }

    /// Any pair of numbers with an error of its own kind.
    pub fn with_error(
        case: impl Into<String>,
        parameter: impl Into<String>,
        (expected, got): (f64, f64),
        error: f64,
        limit: f64,
    ) -> Self {
        Self {
            case: case.into(),
            parameter: parameter.into(),
            expected,
            got,
            error,
            limit,
        }
    }

    /// Whether the error is within the limit; never for what is not a number.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.error <= self.limit
    }
}

/// Rows that belong together.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Family {
    /// Its heading.
    pub name: &'static str,
    /// What is compared, and what limits it.
    pub note: &'static str,
    /// In the order in which they ran.
    pub rows: Vec<Row>,
}

/// All families as a document in Markdown: the notes of all first, then a table each.
#[must_use]
pub fn markdown(families: &[Family]) -> String {
    let mut out = String::from(HEAD);
    for family in families {
        let failed = family.rows.iter().filter(|r| !r.passed()).count();
        let _ = writeln!(
            out,
            "\n## {}\n\n{}\n\n{} rows, {failed} failed.",
            family.name,
            family.note,
            family.rows.len()
        );
    }
    out.push_str("\n# Tables\n");
    for family in families {
        let _ = writeln!(
            out,
            "\n### {}\n\n| case | parameter | expected | got | relative error | limit | verdict |\n\
             | --- | --- | --- | --- | --- | --- | --- |",
            family.name
        );
        for row in &family.rows {
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} | {} | {} |",
                row.case,
                row.parameter,
                figure(row.expected),
                figure(row.got),
                short(row.error),
                short(row.limit),
                if row.passed() { "ok" } else { "FAILED" }
            );
        }
    }
    out
}

const HEAD: &str = "# Stability\n\n\
    What `lvox stability` prints: lvox beside closed forms, quadrature and stated limits, at \
    parameters from one end of\n\
    their range to the other. It takes about a minute and exits with 1 if a row fails. Errors are \
    relative to what was expected;\n\
    where that is 0 they are absolute. `tests/stability.rs` runs the same cases, the heavy ones \
    with fewer points. Rows of the part\n\
    Precision are of the built-in scene; `lvox stability SCENE` takes any other.\n";

/// Six digits.
fn figure(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        let digits = if value == 0.0 {
            0
        } else {
            (5 - value.abs().log10().floor() as i32).clamp(0, 8)
        };
        let text = format!("{value:.*}", digits as usize);
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').into()
        } else {
            text
        }
    } else {
        format!("{value:.5e}")
    }
}

fn short(value: f64) -> String {
    if value == 0.0 {
        "0".into()
    } else {
        format!("{value:.1e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_a_number_fails() {
        assert!(Row::relative("a", "b", 2.0, 2.0, 0.0).passed());
        assert!(!Row::relative("a", "b", 2.0, f64::NAN, 1.0).passed());
        assert!(!Row::nothing("a", "b", f64::INFINITY, 1.0).passed());
        assert!(!Row::count("a", "b", 1).passed());
    }

    #[test]
    fn numbers_keep_six_digits() {
        let figures = [0.0, 1.0, 0.5, 123_456.4, 1.0 / 3.0, 1e-8, -2.5e7].map(figure);
        let expected = [
            "0",
            "1",
            "0.5",
            "123456",
            "0.333333",
            "1.00000e-8",
            "-2.50000e7",
        ];
        assert_eq!(figures, expected);
    }
}
