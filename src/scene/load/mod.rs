//! From files to a checked [`Scene`].
//!
//! A scene file is TOML; every key that is not listed here is an error. Paths are relative to the scene file. Lengths
//! are in world units, angles in degrees, colours linear Rec.709, matrices four rows of four for column vectors.
//!
//! ```toml
//! name = "corner"                       # optional
//!
//! [film]                                # optional: 640 x 480, exposure 1
//! width = 480
//! height = 360
//! exposure = 1.5                        # factor before the tone curve of previews
//!
//! [[camera]]                            # any number, the first is the default; none: everything is framed
//! name = "front"                        # optional: "camera 1", ...
//! position = [0, 1, 4]
//! target = [0, 1, 0]
//! up = [0, 1, 0]                        # optional
//! # camera_to_world = [[1,0,0,0],[0,1,0,1],[0,0,1,4],[0,0,0,1]]   instead: rotation and position, looks down -z
//! fov_x_deg = 40                        # full horizontal angle, optional: 45
//!
//! [[mesh]]
//! file = "room.obj"                     # .obj .ply .gltf .glb, or "builtin:quad" "builtin:cube" "builtin:sphere"
//!                                       # "builtin:torus" (see below)
//! name = "room"                         # optional
//! scale = 2                             # optional, or [x, y, z]
//! rotate_deg = [0, 90, 0]               # optional: about x, then y, then z
//! translate = [0, 0, -1]                # optional; order: scale, rotate, translate
//! # transform = [[...],[...],[...],[0,0,0,1]]                     instead of the three
//! albedo = [0.7, 0.7, 0.7]              # optional: replaces all colours and textures of the file
//! texture = "tiles.png"                 # optional: factor on `albedo` (1 if not given), needs texture coordinates
//! palette = [[0.8,0.1,0.1], [0.5,0.5,0.5]]   # optional: albedo of each `material_index` of a PLY
//! emission = [5, 5, 4]                  # optional: radiance, replaces that of the file
//! emits_both_sides = false              # optional: the front is where corners run counter-clockwise
//! normals = "given"                     # "face", "given", or { crease_deg = 40 }; optional: "given" if the file has any
//! import = ["cameras", "lights"]        # optional, glTF only: what to take from the file beside the meshes
//!
//! [[light]]                             # none at all, and no emission: an environment of radiance 1
//! type = "point"
//! position = [0, 2, 0]
//! intensity = [3, 3, 3]                 # per steradian; irradiance is intensity cos / distance^2
//!
//! [[light]]
//! type = "spot"
//! position = [0, 2, 0]
//! direction = [0, -1, 0]                # or target = [x, y, z]
//! intensity = [3, 3, 3]
//! inner_deg = 20                        # half angle of full intensity, optional: 0
//! outer_deg = 30                        # half angle beyond which there is none
//!
//! [[light]]
//! type = "directional"
//! direction = [0.3, -0.9, 0]            # the way the light travels
//! irradiance = [6, 5.6, 4.8]            # on a plane that faces the light
//! angular_radius_deg = 0.27             # half angle of the disk, optional: 0
//!
//! [[light]]
//! type = "environment"
//! radiance = [0.4, 0.5, 0.7]
//!
//! [[volume]]                            # any number; may overlap, extinctions add
//! file = "smoke.raw"                    # .vdb .nrrd .nhdr .raw, or "builtin:plume"
//! name = "smoke"                        # optional
//! dims = [64, 64, 64]                   # .raw only: voxels, x fastest
//! dtype = "f32"                         # .raw only: u8 i8 u16 i16 u32 i32 f32 f64
//! endian = "little"                     # .raw only, optional
//! grid = "density"                      # .vdb only, optional: "density" if there, else the only fog volume
//! sigma_t_scale = 25                    # extinction per world unit where the scaled value is 1
//! value_scale = 1                       # optional: factor on the values, such as 1/255
//! # window = [150, 1200]                instead: these values become 0 and 1, those outside are clamped
//! albedo = [0.8, 0.8, 0.8]              # sigma_s / sigma_t
//! unitcube_to_world = [[0.9,0,0,-0.4],[0,0.9,0,0],[0,0,0.9,-0.4],[0,0,0,1]]   # the box of all voxels is [0,1]^3
//! # world_from_index = [[...],...]      instead: the sample of voxel (i,j,k) is at (i,j,k) of this map
//! #                                     neither: where the file says it is
//! # scale, rotate_deg, translate or transform, applied on top
//! ```
//!
//! Built-in meshes: `quad` (1 x 1 in the xz plane, faces +y), `cube` (edge 1), `sphere` (radius 1/2), `torus` (about y,
//! outer radius 1/2, tube 0.18), all centred at the origin. `builtin:plume` is a column of smoke that rises along y
//! through its unit cube.
//!
//! glTF: nodes, base colour factor and texture, emissive factor and strength as radiance, vertex colours, cameras, and
//! KHR_lights_punctual taken plainly as radiometric: candela is intensity, lux is irradiance, 1:1. A `.gltf` or `.glb`
//! can also stand for the whole scene.

mod builtin;
mod description;
mod draft;
mod field;
mod files;
mod gltf;
mod mtl;
mod normals;
mod nrrd;
mod obj;
mod part;
mod place;
mod ply;
mod raw;
mod table;
mod texture;
mod vdb;

use super::Scene;
use crate::{Error, Result};
use files::Files;
use std::path::Path;

/// Emission, intensity and irradiance beyond this are taken for a mistake.
const BRIGHTEST: f32 = 1e30;

impl Scene {
    /// Reads and checks a scene: a `.toml` scene file, or a `.gltf` or `.glb` by itself.
    ///
    /// # Errors
    /// Of kind [`crate::Kind::Input`] for anything wrong with the files; the message names the file and the line or
    /// element.
    pub fn load(path: &Path) -> Result<Self> {
        let mut files = Files::default();
        let draft = match files::extension(path).as_str() {
            "toml" => {
                let text = files.read("scene", path)?;
                let text = String::from_utf8(text).map_err(|e| {
                    Error::input(format!("{}: not UTF-8 text: {e}", path.display()))
                })?;
                description::read(&text, path, &mut files)?
            }
            "gltf" | "glb" => {
                let content = files.read("scene", path)?;
                let import =
                    gltf::read(&content, path, &mut files).map_err(|e| e.at(path.display()))?;
                import.into_draft(path).map_err(|e| e.at(path.display()))?
            }
            other => {
                return Err(Error::input(format!(
                    "{}: expected a scene file, found the extension \"{other}\"",
                    path.display()
                ))
                .hint("scenes are .toml, .gltf or .glb files"));
            }
        };
        draft.finish(files).map_err(|e| e.at(path.display()))
    }
}
