//! What goes wrong has a message of its own that names the file and the line or element, and is
//! called wrong input.

mod assets;

use crate::{Folder, load};
use lvox::Kind;
use lvox::scene::Scene;
use std::fs;

const CUBE: &str = "[[mesh]]\nfile = \"builtin:cube\"\n";
const RAW: &str = "[[volume]]\nfile = \"a.raw\"\ndims = [2, 1, 1]\ndtype = \"f32\"\n\
albedo = [1, 1, 1]\nsigma_t_scale = 1\n\
world_from_index = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n";

/// Message and hint of a scene that must not load.
fn refused(text: &str, files: &[(&str, &[u8])]) -> (String, String) {
    let error = match load(text, files) {
        Ok(_) => panic!("loaded:\n{text}"),
        Err(error) => error,
    };
    assert_eq!(error.kind(), Kind::Input, "{error}");
    let hint = error.hint_text().unwrap_or_default().to_string();
    (error.to_string(), hint)
}

#[test]
fn places_and_sizes_beyond_f32() {
    let raw = [1.0_f32, 2.0].map(f32::to_le_bytes).concat();
    // Text after a cube; what the message must contain.
    let volume = |placement: &str| format!("{RAW}{placement}\nname = \"fog\"\n");
    let camera = "[[camera]]\nname = \"main\"\ntarget = [0, 0, 0]\nposition = ";
    let light = "[[light]]\ntype = \"point\"\nintensity = [1, 1, 1]\nposition = ";
    let far = "is farther than 1e15 from the origin";
    let thin = "expected voxels of at least 1e-15 units in each direction, found 9.99";
    for (text, says) in [
        (volume("scale = 1e39"), ["\"fog\": a corner", far]),
        (volume("scale = 1e200"), ["\"fog\": a corner", far]),
        (
            volume("translate = [0, 0, -1e16]"),
            ["\"fog\": a corner", far],
        ),
        (
            volume("scale = 1e-40"),
            ["\"fog\": ", "expected voxels of at least 1e-15 units"],
        ),
        (volume("scale = [1, 9.995e-16, 1]"), ["\"fog\": ", thin]),
        (
            format!("{light}[0, 1e25, 0]"),
            ["light 1: the position", far],
        ),
        (
            format!("{camera}[0, 0, 1e30]"),
            ["\"main\": the position", far],
        ),
    ] {
        let (message, hint) = refused(&format!("{CUBE}{text}"), &[("a.raw", &raw)]);
        assert!(message.contains("scene.toml: "), "{message}");
        assert!(says.iter().all(|s| message.contains(s)), "{message}");
        assert!(!hint.is_empty());
    }
    for text in [
        volume("scale = 1e14"),
        volume("scale = 1.001e-15"),
        format!("{light}[0, 1e15, 0]"),
        format!("{camera}[0, 0, -1e15]"),
    ] {
        load(&format!("{CUBE}{text}"), &[("a.raw", &raw)]).unwrap();
    }
}

/// Text after a cube, what the message must contain, and what the hint must contain.
type Mistake = (&'static str, &'static str, &'static str);

#[track_caller]
fn are_told(mistakes: &[Mistake]) {
    for (text, message, hint) in mistakes {
        let found = refused(&format!("{CUBE}{text}\n"), &[]);
        assert!(found.0.contains("scene.toml"), "{}", found.0);
        assert!(found.0.contains(message), "{}\nis not\n{message}", found.0);
        assert!(found.1.contains(hint), "{}\nis not\n{hint}", found.1);
    }
}

const MESHES: &[Mistake] = &[
    (
        "albdo = [1, 1, 1]",
        "unknown key `albdo` in [[mesh]] at line 3",
        "did you mean `albedo`?",
    ),
    (
        "[[meshes]]",
        "unknown key `meshes` in the scene at line 3",
        "did you mean `mesh`?",
    ),
    ("albedo = [1, 1", "not valid TOML at line 3", ""),
    ("[mesh]", "duplicate key", "begins with [[mesh]]"),
    (
        "albedo = [1.5, 0, 0]",
        "`albedo` in [[mesh]] at line 3: expected three numbers from 0 to 1, found 1.5",
        "",
    ),
    (
        "emission = [-1, 0, 0]",
        "`emission` in [[mesh]] at line 3: -1 is negative",
        "",
    ),
    (
        "emission = [inf, 0, 0]",
        "expected a finite number, found the float inf",
        "",
    ),
    ("translate = [nan, 0, 0]", "expected a finite number", ""),
    (
        "translate = [1e16, 0, 0]",
        "[[mesh]] at line 1: vertex 0: the position",
        "",
    ),
    (
        "scale = [1, 0, 1]",
        "`scale` in [[mesh]] at line 3: a scale of zero flattens space",
        "",
    ),
    (
        "transform = [[1,0,0,0],[1,0,0,0],[0,0,1,0],[0,0,0,1]]",
        "the matrix is singular",
        "",
    ),
    (
        "transform = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]",
        "expected 0 0 0 1 as the last row",
        "",
    ),
    (
        "scale = 1\ntransform = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
        "exclude each other",
        "",
    ),
    (
        "normals = \"giveen\"",
        "expected one of face, given",
        "did you mean \"given\"?",
    ),
    (
        "normals = \"given\"",
        "the file has no normals",
        "crease_deg",
    ),
    (
        "normals = { crease = 4 }",
        "unknown key `crease` in `normals`",
        "did you mean `crease_deg`?",
    ),
    (
        "normals = { crease_deg = 400 }",
        "expected a number from 0 to 180, found 400",
        "",
    ),
    ("texture = \"no.png\"", "texture file", "looked for /"),
    (
        "import = [\"lights\"]",
        "only .gltf and .glb files have this key",
        "",
    ),
    ("palette = [[1, 1, 1]]", "only .ply files have this key", ""),
    (
        "name = 3",
        "expected text in quotes, found the integer 3",
        "",
    ),
    (
        "[[mesh]]\nname = \"x\"",
        "[[mesh]] at line 3: `file` is missing",
        "",
    ),
    (
        "[[mesh]]\nfile = \"no.ply\"",
        "[[mesh]] at line 3: mesh file",
        "looked for /",
    ),
    (
        "[[mesh]]\nfile = \"a.fbx\"",
        "the extension \"fbx\" is not supported",
        ".obj, .ply",
    ),
    (
        "[[mesh]]\nfile = \"builtin:kube\"",
        "there is no built-in mesh \"kube\"",
        "builtin:cube",
    ),
    (
        "[[mesh]]\nfile = \"builtin:quad\"\nvisible = \"no\"",
        "expected true or false",
        "",
    ),
];

#[test]
fn mistakes_in_meshes_and_in_keys_of_a_scene_are_told() {
    are_told(MESHES);
}

const FILMS: &[Mistake] = &[
    (
        "[film]\nwidth = 65537\nheight = 1",
        "a whole number from 1 to 65536, found 65537",
        "",
    ),
    ("[film]\nwidth = 0\nheight = 1", "found 0", ""),
    (
        "[film]\nwidth = 1.5\nheight = 1",
        "expected a whole number from 1 to 65536, found the float 1.5",
        "",
    ),
    (
        "[film]\nwidth = 5",
        "[film] at line 3: `height` is missing",
        "",
    ),
];

#[test]
fn mistakes_in_films_are_told() {
    are_told(FILMS);
}

const CAMERAS: &[Mistake] = &[
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\nfov_x_deg = 180",
        "expected a number from 0.01 to 179, found 180",
        "",
    ),
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\naperture = 0.1",
        "`aperture` needs a `focus_distance`",
        "",
    ),
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\naperture = -1\n\
         focus_distance = 1",
        "expected a number from 0 to 1e15, found -1",
        "",
    ),
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\nshutter = [0.5, 0.5]",
        "expected when the shutter opens and, later, closes",
        "",
    ),
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 0, 0]",
        "at its own target",
        "",
    ),
    (
        "[[camera]]\nposition = [0, 0, 0]\ntarget = [0, 5, 0]",
        "along its `up`",
        "",
    ),
    (
        "[[camera]]\ncamera_to_world = [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
        "expected a rotation and a position",
        "",
    ),
    (
        "[[camera]]\nname = \"a\"\nposition = [0,0,1]\ntarget = [0,0,0]\n\
         [[camera]]\nname = \"a\"\nposition = [0,0,1]\ntarget = [0,0,0]",
        "another camera has the name \"a\" too",
        "",
    ),
];

#[test]
fn mistakes_in_cameras_are_told() {
    are_told(CAMERAS);
}

const LIGHTS: &[Mistake] = &[
    (
        "[[light]]\ntype = \"pont\"",
        "expected one of point, spot",
        "did you mean \"point\"?",
    ),
    (
        "[[light]]\ntype = \"point\"\nposition = [0, 0, 0]\nintensity = [-1, 0, 0]",
        "-1 is negative",
        "",
    ),
    (
        "[[light]]\ntype = \"point\"\nposition = [0, 0, 0]\nradiance = [1, 0, 0]",
        "has no `radiance`",
        "position, intensity",
    ),
    (
        "[[light]]\ntype = \"directional\"\ndirection = [0, 0, 0]\nirradiance = [1, 0, 0]",
        "zero length",
        "",
    ),
    (
        "[[light]]\ntype = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, 1, 0]\n\
         intensity = [1, 0, 0]\ninner_deg = 30\nouter_deg = 20",
        "expected more than the 30",
        "",
    ),
    (
        "[[light]]\ntype = \"directional\"\nimage = \"a.exr\"",
        "no `image`",
        "irradiance",
    ),
    (
        "[[light]]\ntype = \"point\"\nposition = [0, 2, 0]\nintensity = [1, 1, 1]\n\
         visible = false",
        "no `visible`",
        "its keys are position, intensity",
    ),
];

#[test]
fn mistakes_in_lights_are_told() {
    are_told(LIGHTS);
}

const ENVIRONMENTS: &[Mistake] = &[
    (
        "[[light]]\ntype = \"environment\"\nradiance = [1e38, 0, 0]",
        "from 0 to 1e30, found 1e38",
        "",
    ),
    (
        "[[light]]\ntype = \"environment\"\nimage = \"no.exr\"",
        "environment image file",
        "looked for /",
    ),
    (
        "[[light]]\ntype = \"environment\"\nimage = \"sky.png\"",
        "\"png\" is not supported",
        ".exr or .hdr",
    ),
    (
        "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\nrotate_deg = 9",
        "no `rotate_deg`",
        "image",
    ),
    (
        "[[light]]\ntype = \"environment\"\nimage = \"a.exr\"\nsun = \"drop\"",
        "expected one of extract, keep",
        "",
    ),
    (
        "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\nvisible = 0",
        "expected true or false",
        "",
    ),
    (
        "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\nvisible = false\n\
         [[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]",
        "expected `visible` to be the same for all environments",
        "to each of them, or to none",
    ),
];

#[test]
fn mistakes_in_environments_are_told() {
    are_told(ENVIRONMENTS);
}

const VOLUMES: &[Mistake] = &[
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]",
        "`sigma_t_scale` is missing",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = -2",
        "found -2",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = [1, -2, 1]",
        "expected numbers from 0 to 1e30, found -2",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = [1, 2]",
        "expected 3 numbers in brackets, found 2",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.nrrd\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         albedo_grid = \"Cd\"",
        "only .vdb files have this key",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1",
        "`dims` is missing",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\ndims = [0, 1, 1]",
        "three whole numbers of at least 1",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.raw\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         dims = [1, 1, 1]\ndtype = \"f16\"",
        "expected one of u8",
        "",
    ),
    (
        "[[volume]]\nfile = \"a.nrrd\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         dims = [1, 1, 1]",
        "only .raw files have this key",
        "",
    ),
    (
        "[[volume]]\nfile = \"no.vdb\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1",
        "volume file",
        "looked for /",
    ),
    (
        "[[volume]]\nfile = \"a.dcm\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1",
        "\"dcm\" is not supported",
        "dcm2niix",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         window = [2, 2]",
        "low end first",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1",
        "does not say where the volume is",
        "unitcube_to_world",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [2, 1, 1]\nsigma_t_scale = 1",
        "from 0 to 1, found 2",
        "",
    ),
];

#[test]
fn mistakes_in_volumes_are_told() {
    are_told(VOLUMES);
}

const EMISSIONS: &[Mistake] = &[
    (
        "[[volume]]\nfile = \"builtin:flame\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         emission = { color = [1, 0, 0] }",
        "`emission` at line 7: expected `scale`",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:flame\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         emission = { kelvin = 1, color = [1, 0, 0] }",
        "`color` and `kelvin` exclude each other",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:flame\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         emission = { scale = -1 }",
        "expected a number from 0 to 1e30, found -1",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:flame\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         emission = { scale = 1, file = \"no.vdb\" }\n\
         unitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
        "no.vdb",
        "",
    ),
];

#[test]
fn mistakes_in_what_volumes_emit_are_told() {
    are_told(EMISSIONS);
}

const PHASE_FUNCTIONS: &[Mistake] = &[
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\ng = 1",
        "`g` in [[volume]] at line 7: expected a number from -0.99 to 0.99, found 1",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         g = [0.5, -2]\nmix = 0.5",
        "expected two numbers from -0.99 to 0.99, found -2",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         g = [0.5]\nmix = 0.5",
        "expected 2 numbers in brackets, found 1",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         g = [0.5, -0.5]",
        "`mix` is missing",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         g = [0.5, -0.5]\nmix = 1.5",
        "expected a number from 0 to 1, found 1.5",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\ng = 0.5\n\
         mix = 0.5",
        "`mix` in [[volume]] at line 8: expected two lobes to weigh",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         mix = 0.5",
        "there is no `g` that it could weigh",
        "",
    ),
    (
        "[[volume]]\nfile = \"builtin:plume\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
         g = \"mie\"",
        "expected a number",
        "",
    ),
];

#[test]
fn mistakes_in_phase_functions_are_told() {
    are_told(PHASE_FUNCTIONS);
}

#[test]
fn scenes_as_a_whole() {
    assert!(refused("", &[]).0.contains("neither triangles nor volumes"));
    let folder = Folder::new(&[("a.txt", b""), ("bad.toml", b"\xff")]);
    let message = |name: &str| {
        let error = Scene::load(&folder.path(name)).unwrap_err();
        assert_eq!(error.kind(), Kind::Input);
        error.to_string()
    };
    assert!(message("no.toml").contains("is not there"));
    assert!(message("a.txt").contains("expected a scene file"));
    assert!(message("bad.toml").contains("not UTF-8"));
}

/// Before they take memory.
#[test]
fn descriptions_that_are_too_large() {
    let values = format!("name = [{}]", "0,".repeat(5 << 20));
    let (message, hint) = refused(&values, &[]);
    let expected = "scene.toml: expected at most 4194304 values, found 5242880";
    assert!(message.ends_with(expected), "{message}");
    assert!(hint.contains("mesh and volume files"));
    assert!(
        refused(&"[[a]]\n".repeat(4 << 20), &[])
            .0
            .contains("expected at most 16777216 marks")
    );
    let folder = Folder::new(&[]);
    let path = folder.path("scene.toml");
    let file = fs::File::create(&path).unwrap();
    file.set_len((64 << 20) + 1).unwrap();
    let error = Scene::load(&path).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("of at most 64.0 MiB, found 64.0 MiB"),
        "{error}"
    );
}
