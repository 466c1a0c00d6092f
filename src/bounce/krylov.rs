//! Linear systems whose matrix is only known by what it makes of a vector: GMRES (Saad & Schultz
//! 1986).

use super::sweeps::Light;
use crate::Result;

/// What a solver found.
pub struct Solved {
    /// The solution.
    pub x: Vec<Light>,
    /// How often the matrix was asked.
    pub products: u32,
    /// Length of the residual over that of the right side.
    pub residual: f64,
}

/// Vectors that are kept; then the search starts again from what was found.
pub const KEPT: usize = 10;

/// Solves `a x = b`, from a first guess, until the residual is below `tolerance` or after so many
/// products. Sums are in a fixed order.
///
/// # Errors
/// Those of `a`.
pub fn solve(
    mut a: impl FnMut(&[Light]) -> Result<Vec<Light>>,
    b: &[Light],
    mut x: Vec<Light>,
    tolerance: f64,
    most: u32,
) -> Result<Solved> {
    let scale = dot(b, b).sqrt();
    let mut products = 0;
    loop {
        let mut r = a(&x)?;
        products += 1;
        r.iter_mut().zip(b).for_each(|(r, b)| *r = *b - *r);
        let mut residual = dot(&r, &r).sqrt();
        if scale == 0.0 || residual <= tolerance * scale || products >= most {
            let residual = if scale > 0.0 { residual / scale } else { 0.0 };
            return Ok(Solved {
                x,
                products,
                residual,
            });
        }
        let mut basis = vec![scaled(&r, 1.0 / residual)];
        // Columns of the Hessenberg matrix, turned to a triangle as they come.
        let mut columns: Vec<Vec<f64>> = Vec::new();
        let mut turns: Vec<(f64, f64)> = Vec::new();
        let mut right = vec![residual];
        while columns.len() < KEPT && residual > tolerance * scale && products < most {
            let mut next = a(&basis[columns.len()])?;
            products += 1;
            let mut column: Vec<f64> = Vec::with_capacity(basis.len() + 1);
            for v in &basis {
                let along = dot(v, &next);
                let part = along as f32;
                next.iter_mut().zip(v).for_each(|(n, v)| *n -= *v * part);
                column.push(along);
            }
            let rest = dot(&next, &next).sqrt();
            for (i, (c, s)) in turns.iter().enumerate() {
                let (upper, lower) = (column[i], column[i + 1]);
                column[i] = c * upper + s * lower;
                column[i + 1] = c * lower - s * upper;
            }
            let last = column.len() - 1;
            let length = (column[last] * column[last] + rest * rest).sqrt();
            if length == 0.0 {
                break;
            }
            let (c, s) = (column[last] / length, rest / length);
            column[last] = length;
            turns.push((c, s));
            right.push(-s * right[last]);
            right[last] *= c;
            residual = right[last + 1].abs();
            columns.push(column);
            if rest == 0.0 {
                break;
            }
            basis.push(scaled(&next, 1.0 / rest));
        }
        let mut y = vec![0.0; columns.len()];
        for i in (0..columns.len()).rev() {
            let known: f64 = (i + 1..columns.len()).map(|k| columns[k][i] * y[k]).sum();
            y[i] = (right[i] - known) / columns[i][i];
        }
        for (v, y) in basis.iter().zip(&y) {
            let y = *y as f32;
            x.iter_mut().zip(v).for_each(|(x, v)| *x += *v * y);
        }
        if columns.is_empty() {
            products = most;
        }
    }
}

fn dot(a: &[Light], b: &[Light]) -> f64 {
    let of = |(a, b): (&Light, &Light)| (*a * *b).to_array().map(f64::from).iter().sum::<f64>();
    a.iter().zip(b).map(of).sum()
}

fn scaled(v: &[Light], by: f64) -> Vec<Light> {
    let by = by as f32;
    v.iter().map(|v| *v * by).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_that_scatters_nearly_all_is_solved_in_few_products() {
        // Light that goes on to the next cell on either side: x - c (left + right) / 2 = 1.
        let (count, c) = (40, 0.999);
        let a = |x: &[Light]| {
            let at = |i: usize| x.get(i).copied().unwrap_or(Light::ZERO);
            let of = |i| at(i) - (at(i.wrapping_sub(1)) + at(i + 1)) * (0.5 * c);
            Ok((0..count).map(of).collect())
        };
        let b = vec![Light::new(1.0, 2.0, 0.5); count];
        let found = solve(a, &b, vec![Light::ZERO; count], 1e-4, 300).unwrap();
        assert!(found.residual <= 1e-4, "{}", found.residual);
        assert!(found.products < 300, "{}", found.products);
        let product = a(&found.x).unwrap();
        for (p, b) in product.iter().zip(&b) {
            assert!((*p - *b).abs().max_element() < 1e-2, "{p}");
        }
        let nothing = solve(
            a,
            &vec![Light::ZERO; count],
            vec![Light::ZERO; count],
            1e-5,
            9,
        );
        assert!(nothing.unwrap().x.iter().all(|x| *x == Light::ZERO));
    }
}
