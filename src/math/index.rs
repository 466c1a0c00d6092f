//! The numbers of cells in a grid.

use std::ops::{Div, Rem};

/// The cell of a number that counts the cells of a grid, x fastest.
#[must_use]
#[inline]
pub fn unflatten<T>(i: T, [nx, ny, _]: [T; 3]) -> [T; 3]
where
    T: Copy + Div<Output = T> + Rem<Output = T>,
{
    [i % nx, i / nx % ny, i / nx / ny]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_has_its_number() {
        let dims = [3, 4, 5];
        for i in 0..60 {
            let [x, y, z] = unflatten(i, dims);
            assert_eq!((z * 4 + y) * 3 + x, i);
            assert!(x < 3 && y < 4 && z < 5);
        }
    }
}
