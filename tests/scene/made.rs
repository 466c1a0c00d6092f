//! Scenes that are made in memory.

use glam::{DAffine3, DVec3};
use lvox::Result;
use lvox::scene::{
    CameraInput, EnvironmentImage, EnvironmentInput, Film, Grid, Light, LightInput, Material,
    MeshInput, PhaseFunction, Scene, SceneBuilder, VolumeInput,
};

const CORNERS: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];

fn triangle() -> MeshInput {
    MeshInput::new("floor", CORNERS, vec![[0, 1, 2]])
}

fn fog(albedo: f32, map: DAffine3) -> VolumeInput {
    let grid = Grid::dense([2, 1, 1], &[0.5, 1.0]).unwrap();
    VolumeInput::new("fog", grid, [albedo; 3], map)
}

fn camera(name: &str) -> Result<CameraInput> {
    CameraInput::look_at(name, [0.0, 1.0, 5.0], [0.0; 3], DVec3::Y, 0.8)
}

#[test]
fn what_is_made_is_what_a_file_would_make() {
    let made = SceneBuilder::new("scene")
        .film(Film {
            width: 32,
            height: 24,
            exposure: 2.0,
        })
        .camera(camera("front").unwrap())
        .mesh(triangle().albedo([0.25; 3]).emission([2.0; 3]))
        .light(LightInput::point([1e6, 2.0, 0.0], [3.0; 3]))
        .light(LightInput::spot([0.0; 3], [0.0, -2.0, 0.0], [1.0; 3], 0.25, 0.5).unwrap())
        .light(LightInput::sun([3.0, -4.0, 0.0], [1.0; 3], 0.0).unwrap())
        .volume(
            fog(0.5, DAffine3::from_scale(DVec3::splat(2.0)))
                .phase(PhaseFunction::two_lobes([0.8, -0.25], 0.75)),
        )
        .build()
        .unwrap();
    let text = format!(
        "name = \"scene\"\n[film]\nwidth = 32\nheight = 24\nexposure = 2\n\
         [[camera]]\nname = \"front\"\nposition = [0, 1, 5]\ntarget = [0, 0, 0]\nfov_x_deg = {}\n\
         [[mesh]]\nfile = \"a.obj\"\nalbedo = [0.25, 0.25, 0.25]\nemission = [2, 2, 2]\n\
         [[light]]\ntype = \"point\"\nposition = [1e6, 2, 0]\nintensity = [3, 3, 3]\n\
         [[light]]\ntype = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, -1, 0]\n\
         intensity = [1, 1, 1]\ninner_deg = {}\nouter_deg = {}\n\
         [[light]]\ntype = \"directional\"\ndirection = [3, -4, 0]\nirradiance = [1, 1, 1]\n\
         [[volume]]\nfile = \"a.raw\"\nname = \"fog\"\ndims = [2, 1, 1]\ndtype = \"f32\"\n\
         sigma_t_scale = 1\nalbedo = [0.5, 0.5, 0.5]\ng = [0.8, -0.25]\nmix = 0.75\n\
         unitcube_to_world = [[4,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]\n",
        0.8_f64.to_degrees(),
        0.25_f64.to_degrees(),
        0.5_f64.to_degrees()
    );
    let obj = b"v 0 0 0\nv 1 0 0\nv 0 0 -1\nf 1 2 3\n";
    let raw = [0.5_f32, 1.0].map(f32::to_le_bytes).concat();
    let read = crate::load(&text, &[("a.obj", obj), ("a.raw", &raw)]).unwrap();
    assert_eq!(made.parts(None), read.parts(None));
    assert_eq!(made.film, read.film);
    let phases = [&made, &read].map(|s| s.volumes[0].phase);
    assert_eq!(phases, [PhaseFunction::two_lobes([0.8, -0.25], 0.75); 2]);
    let lens = |s: &Scene| (s.cameras[0].scene_from_camera, s.cameras[0].fov_x_rad);
    assert_eq!(lens(&made).0, lens(&read).0);
    assert!((lens(&made).1 - lens(&read).1).abs() < 1e-6);
    assert_eq!(made.warnings, [] as [String; 0]);
    assert!(made.files.is_empty() && made.hash != [0; 32]);
}

#[test]
fn what_is_not_given_is_made_up_and_told() {
    let scene = SceneBuilder::new("").mesh(triangle()).build().unwrap();
    assert_eq!((scene.film.width, scene.cameras.len()), (640, 1));
    assert_eq!(scene.lights, [Light::Environment { radiance: [1.0; 3] }]);
    assert_eq!(scene.warnings.len(), 2, "{:?}", scene.warnings);
    let other = SceneBuilder::new("").mesh(triangle().albedo([0.1; 3]));
    assert_ne!(scene.hash, other.build().unwrap().hash);
    let foggy = |g: f32| {
        let fog = fog(0.5, DAffine3::IDENTITY).phase(PhaseFunction::henyey_greenstein(g));
        SceneBuilder::new("").volume(fog).build().unwrap().hash
    };
    assert!(foggy(0.0) != foggy(0.1) && foggy(0.1) != foggy(-0.1));
}

#[test]
fn what_is_wrong_is_refused_by_name() {
    let message = |builder: SceneBuilder| builder.build().unwrap_err().to_string();
    let mesh = |mesh| message(SceneBuilder::default().mesh(mesh));
    let grey = || vec![Material::diffuse("grey", [0.5; 3])];
    assert!(message(SceneBuilder::default()).contains("neither triangles nor volumes"));
    for (mesh_with, says) in [
        (
            MeshInput::new("a", [[f64::NAN; 3]], vec![[0; 3]]),
            "mesh 1: vertex 0: the position is not finite",
        ),
        (
            MeshInput::new("a", CORNERS, vec![[0, 1, 3]]),
            "mesh 1: triangle 0 refers to the vertices [0, 1, 3]",
        ),
        (triangle().albedo([2.0; 3]), "`floor`: the albedo"),
        (triangle().emission([-1.0; 3]), "`floor`: the emission"),
        (triangle().uvs(vec![]).colors(vec![[1.0; 3]]), "3 colours"),
        (triangle().normals(vec![glam::Vec3::Y]), "3 normals"),
        (triangle().materials(grey(), vec![1], vec![]), "material 1"),
        (triangle().materials(grey(), vec![], vec![]), "1 triangles"),
        (
            triangle().transform(&DAffine3::from_scale(DVec3::splat(1e16))),
            "farther than 1e15",
        ),
    ] {
        let message = mesh(mesh_with);
        assert!(message.contains(says), "{message}");
    }
    let scene = || SceneBuilder::default().mesh(triangle());
    let film = Film {
        width: 0,
        height: 1,
        exposure: 1.0,
    };
    let turn = DAffine3::IDENTITY;
    let flat = DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.0));
    for (builder, says) in [
        (scene().film(film), "found 0 x 1"),
        (
            scene()
                .camera(camera("a").unwrap())
                .camera(camera("a").unwrap()),
            "two cameras have the name \"a\"",
        ),
        (
            scene().light(LightInput::environment([f32::NAN; 3])),
            "light 1: the colour",
        ),
        (
            scene().light(LightInput::point([1e20; 3], [1.0; 3])),
            "light 1: the position",
        ),
        (
            scene().environment_image(EnvironmentInput::new(sky().scaled([-1.0; 3]))),
            "the factor [-1.0, -1.0, -1.0]",
        ),
        (
            scene().environment_image(EnvironmentInput::new(sky().rotated(f32::NAN))),
            "turned by NaN",
        ),
        (scene().volume(fog(1.5, turn)), "`fog`: the albedo"),
        (
            scene().volume(fog(0.5, turn).phase(PhaseFunction::henyey_greenstein(1.0))),
            "`fog`: the phase function",
        ),
        (scene().volume(fog(0.5, flat)), "singular"),
    ] {
        let message = message(builder);
        assert!(message.contains(says), "{message}");
    }
    assert!(CameraInput::look_at("a", [0.0; 3], [0.0; 3], DVec3::Y, 0.5).is_err());
    assert!(CameraInput::placed("a", flat, 0.5).is_err());
    assert!(LightInput::spot([0.0; 3], [1.0; 3], [1.0; 3], 0.5, 0.5).is_err());
    assert!(LightInput::sun([0.0; 3], [1.0; 3], 0.1).is_err());
}

/// A sky with a sun of two degrees.
fn sky() -> EnvironmentImage {
    let texel = |i: u32| {
        let (x, y) = (i % 512, i / 512);
        let is_sun = (101..104).contains(&x) && (60..63).contains(&y);
        if is_sun { [9e4; 3] } else { [0.5, 0.6, 1.0] }
    };
    EnvironmentImage::new(512, 256, (0..512 * 256).map(texel).collect()).unwrap()
}

#[test]
fn suns_of_an_environment_image_become_lights_and_are_told() {
    let made = |input| {
        let scene = SceneBuilder::default().mesh(triangle());
        scene.environment_image(input).build().unwrap()
    };
    let scene = made(EnvironmentInput::new(sky()));
    assert_eq!(
        scene.warnings,
        ["the scene has no camera: framing everything from the front"]
    );
    assert!(
        scene.notes[0].contains("a sun 46.8 degrees high"),
        "{:?}",
        scene.notes
    );
    let [
        Light::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        },
    ] = scene.lights[..]
    else {
        panic!("{:?}", scene.lights)
    };
    assert!((direction.y + 0.7288).abs() < 1e-3, "{direction}");
    let image = scene.environment_image.as_ref().unwrap();
    assert_eq!(image.holes().len(), 9);
    assert_eq!(image.light(-direction).0, [0.5, 0.6, 1.0]);
    assert!(image.seen(-direction).0[0] > 8e4);
    assert!(irradiance[0] > 60.0 && (0.01..0.03).contains(&angular_radius_rad));
    let kept = made(EnvironmentInput::new(sky()).keeping_suns());
    assert!(kept.lights.is_empty() && kept.notes.is_empty() && kept.hash != scene.hash);
    let turned = made(EnvironmentInput::new(sky().rotated(0.1)));
    assert!(turned.hash != scene.hash);
}

#[test]
fn an_image_of_one_colour_is_an_environment_of_that() {
    let image = EnvironmentImage::new(4, 2, vec![[0.5, 1.0, 2.0]; 8]).unwrap();
    let input = EnvironmentInput::new(image.scaled([2.0, 1.0, 1.0]));
    let scene = SceneBuilder::default().mesh(triangle());
    let scene = scene.environment_image(input).build().unwrap();
    let radiance = [1.0, 1.0, 2.0];
    assert_eq!(scene.lights, [Light::Environment { radiance }]);
    assert!(scene.environment_image.is_none());
}
