//! The axes of a patient, and how they stand in a world with y up.

use glam::{DAffine3, DMat3, DVec3};

/// The axes of a patient along which a file says where it is, by the sides to which x, y and z go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PatientSpace {
    /// Left, posterior, superior, as DICOM, ITK and Slicer's files have it.
    Lps,
    /// Right, anterior, superior, as NIfTI has it.
    Ras,
    /// Left, anterior, superior.
    Las,
}

impl PatientSpace {
    /// That of a name in a NRRD header.
    pub(super) fn named(name: &str) -> Option<Self> {
        let name = name.trim().to_lowercase();
        Some(match name.trim_end_matches("-time") {
            "left-posterior-superior" | "lps" | "lpst" => Self::Lps,
            "right-anterior-superior" | "ras" | "rast" => Self::Ras,
            "left-anterior-superior" | "las" | "last" => Self::Las,
            _ => return None,
        })
    }

    /// What people call it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
            Self::Las => "LAS",
        }
    }

    /// From this space to left, posterior, superior.
    pub(super) fn to_lps(self) -> DAffine3 {
        DAffine3::from_scale(match self {
            Self::Lps => DVec3::ONE,
            Self::Ras => DVec3::new(-1.0, -1.0, 1.0),
            Self::Las => DVec3::new(1.0, -1.0, 1.0),
        })
    }
}

/// Turns what has z up so that it has y up: x stays, and z becomes y. What is placed by left,
/// posterior and superior then has its left at x, stands upright, and looks along z, at a camera
/// that looks along -z.
pub(super) fn y_up_from_z_up() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_stands_upright_and_looks_at_the_camera() {
        // Its left, nose and crown, by each space.
        for (space, [left, nose, crown]) in [
            (PatientSpace::Lps, [DVec3::X, DVec3::NEG_Y, DVec3::Z]),
            (PatientSpace::Ras, [DVec3::NEG_X, DVec3::Y, DVec3::Z]),
            (PatientSpace::Las, [DVec3::X, DVec3::Y, DVec3::Z]),
        ] {
            let stand = y_up_from_z_up() * space.to_lps();
            let found = [left, nose, crown].map(|v| stand.transform_vector3(v));
            assert_eq!(found, [DVec3::X, DVec3::Z, DVec3::Y], "{space:?}");
            assert_eq!(PatientSpace::named(space.name()), Some(space));
        }
        assert_eq!(y_up_from_z_up().matrix3.determinant(), 1.0, "no mirror");
        assert_eq!(PatientSpace::named("scanner-xyz"), None);
    }
}
