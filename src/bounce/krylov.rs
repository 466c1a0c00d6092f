//! Linear systems whose matrix is only known by what it makes of a vector, and is symmetric once
//! its rows are weighted: conjugate gradients (Hestenes & Stiefel 1952), each channel by itself.

use super::light::{Light, Share};
use crate::Result;
use glam::DVec3;
use rayon::prelude::*;

/// A matrix, and what is about its inverse.
pub struct System<'a, K, A, M> {
    /// By row.
    pub weights: &'a [K],
    /// What the matrix makes of a vector.
    pub product: A,
    /// What about its inverse makes of one; symmetric as the matrix is, and positive.
    pub inverse: M,
}

/// What a solver found.
pub struct Solved {
    /// The solution.
    pub x: Vec<Light>,
    /// How often the matrix was asked.
    pub products: u32,
    /// Length of the residual.
    pub residual: f64,
}

/// Vectors that are kept.
pub const VECTORS: usize = 5;

impl<K: Share, A, M> System<'_, K, A, M>
where
    A: Fn(&[Light]) -> Result<Vec<Light>>,
    M: Fn(&[Light]) -> Vec<Light>,
{
    /// Solves the system from a first guess, of which the residual is known, until that is no
    /// longer than `tolerance` or after so many products. Sums are in a fixed order.
    ///
    /// # Errors
    /// Those of the product.
    pub fn solve(
        &self,
        mut x: Vec<Light>,
        mut rest: Vec<Light>,
        tolerance: f64,
        most: u32,
    ) -> Result<Solved> {
        let weights = self.weights;
        let mut products = 0;
        let mut residual = length(weights, &rest);
        let mut ahead: Vec<Light> = Vec::new();
        let mut known = DVec3::ONE;
        while residual > tolerance && products < most {
            let next = (self.inverse)(&rest);
            let now = dot(weights, &rest, &next);
            if ahead.is_empty() {
                ahead = next;
            } else {
                let along = over(now, known);
                (ahead.par_iter_mut().zip(next)).for_each(|(a, n)| *a = n + *a * along);
            }
            known = now;
            let moved = (self.product)(&ahead)?;
            products += 1;
            let step = over(known, dot(weights, &ahead, &moved));
            if step == Light::ZERO {
                break;
            }
            (x.par_iter_mut().zip(&ahead)).for_each(|(x, a)| *x += *a * step);
            (rest.par_iter_mut().zip(&moved)).for_each(|(r, m)| *r -= *m * step);
            residual = length(weights, &rest);
        }
        Ok(Solved {
            x,
            products,
            residual,
        })
    }
}

/// Ratios by channel; none where nothing is left.
fn over(a: DVec3, b: DVec3) -> Light {
    let ratio = |c: usize| match b[c] > 0.0 {
        true => (a[c] / b[c]) as f32,
        false => 0.0,
    };
    Light::new(ratio(0), ratio(1), ratio(2))
}

/// Length of a vector whose parts count by these weights.
pub fn length<K: Share>(weights: &[K], v: &[Light]) -> f64 {
    dot(weights, v, v).element_sum().sqrt()
}

/// Product of two vectors, by channel.
fn dot<K: Share>(weights: &[K], a: &[Light], b: &[Light]) -> DVec3 {
    /// Parts that are added up together, whatever the threads.
    const TOGETHER: usize = 1 << 12;
    let chunks = weights.par_chunks(TOGETHER).zip(a.par_chunks(TOGETHER));
    let sums = chunks.zip(b.par_chunks(TOGETHER)).map(|((w, a), b)| {
        let of = |((w, a), b): ((&K, &Light), &Light)| {
            a.as_dvec3() * b.as_dvec3() * w.light().as_dvec3()
        };
        w.iter().zip(a).zip(b).map(of).sum::<DVec3>()
    });
    sums.collect::<Vec<_>>().into_iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_that_scatters_nearly_all_is_solved_in_few_products() {
        // Light that goes on to the next cell on either side: x - c (left + right) / 2 = 1.
        let (count, c) = (40, 0.999);
        let product = |x: &[Light]| {
            let at = |i: usize| x.get(i).copied().unwrap_or(Light::ZERO);
            let of = |i| at(i) - (at(i.wrapping_sub(1)) + at(i + 1)) * (0.5 * c);
            Ok((0..count).map(of).collect())
        };
        let system = System {
            weights: &vec![3.0_f32; count],
            product,
            inverse: |r: &[Light]| r.iter().map(|r| *r * 0.5).collect(),
        };
        let dark = vec![Light::ZERO; count];
        let b = vec![Light::new(1.0, 2.0, 0.0); count];
        let found = system.solve(dark.clone(), b.clone(), 1e-3, 300).unwrap();
        assert!(found.residual <= 1e-3, "{}", found.residual);
        assert!(found.products <= 20, "{}", found.products);
        for (p, b) in product(&found.x).unwrap().iter().zip(&b) {
            assert!((*p - *b).abs().max_element() < 1e-2, "{p}");
        }
        let nothing = system.solve(dark.clone(), dark, 0.0, 9).unwrap();
        assert!(nothing.x.iter().all(|x| *x == Light::ZERO));
    }
}
