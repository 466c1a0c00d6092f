//! Scenes of Mitsuba: what is taken of them, what is told, and what is refused.

mod cameras;
mod emission;
mod files;
mod mistakes;
mod transforms;

use crate::support::program::lvox;
use crate::support::skip::shared;
use crate::{Folder, acceptance};
use glam::{Vec2, Vec3};
use lvox::Result;
use lvox::run::Job;
use lvox::scene::load::{Change, Settings};
use lvox::scene::{Lens, Light, PhaseFunction, Scene};
use std::fs;
use std::path::Path;

/// A floor and a wall under all kinds of lights, with media, seen by two cameras.
const SCENE: &str = r##"<scene version="3.0.0">
  <default name="side" value="2"/>
  <integrator type="path"><integer name="max_depth" value="5"/></integrator>
  <sensor type="perspective" id="main">
    <float name="fov" value="90"/><string name="fov_axis" value="y"/><float name="near_clip" value="0.1"/>
    <transform name="to_world"><lookat origin="0, 1, 5" target="0, 1, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="20"/><rfilter type="box"/></film>
    <sampler type="independent"/>
  </sensor>
  <sensor type="thinlens">
    <float name="aperture_radius" value="0.1"/>
    <transform name="to_world"><rotate y="1" angle="180"/><translate z="4"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="20"/></film>
  </sensor>
  <bsdf type="twosided" id="red"><bsdf type="diffuse"><rgb name="reflectance" value="0.5 0.1 0.2"/></bsdf></bsdf>
  <bsdf type="roughplastic" id="plastic"><rgb name="diffuse_reflectance" value="#ff0000"/></bsdf>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="$side"/><rotate x="1" angle="-90"/></transform>
    <ref id="red"/>
  </shape>
  <shape type="obj"><string name="filename" value="a.obj"/><ref id="plastic"/></shape>
  <shape type="sphere"><point name="center" x="1" y="1" z="0"/><float name="radius" value="0.5"/>
    <bsdf type="dielectric"/></shape>
  <shape type="disk"><transform name="to_world"><translate y="3"/></transform>
    <emitter type="area"><rgb name="radiance" value="2"/></emitter></shape>
  <shape type="shapegroup" id="group">
    <shape type="cube"><transform name="to_world"><scale value="0.1"/></transform></shape>
  </shape>
  <shape type="instance"><ref id="group"/><transform name="to_world"><translate x="2"/></transform></shape>
  <shape type="instance"><ref id="group"/></shape>
  <emitter type="point"><point name="position" value="0, 2, 0"/><rgb name="intensity" value="3"/></emitter>
  <emitter type="spot"><rgb name="intensity" value="1, 2, 3"/><float name="cutoff_angle" value="40"/>
    <transform name="to_world"><lookat origin="0, 3, 0" target="0, 0, 0" up="0, 0, 1"/></transform></emitter>
  <emitter type="directional"><vector name="direction" x="0" y="-2" z="0"/></emitter>
  <emitter type="constant"><rgb name="radiance" value="0.25"/></emitter>
  <medium type="heterogeneous" id="smoke">
    <float name="scale" value="10"/>
    <volume name="sigma_t" type="gridvolume"><string name="filename" value="a.vol"/></volume>
    <rgb name="albedo" value="0.9, 0.8, 0.7"/>
    <phase type="hg"><float name="g" value="0.5"/></phase>
  </medium>
  <shape type="cube"><transform name="to_world"><translate value="1"/><scale value="0.5"/></transform>
    <bsdf type="null"/><ref name="interior" id="smoke"/></shape>
  <shape type="cube"><bsdf type="null"/>
    <medium name="interior" type="homogeneous"><rgb name="sigma_t" value="2"/><float name="albedo" value="0.5"/></medium>
  </shape>
</scene>"##;

const OBJ: &[u8] =
    b"mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl x\n\
      f 1/1 2/2 3/3\n";

fn vol(values: &[f32], sizes: [i32; 3]) -> Vec<u8> {
    let mut bytes = b"VOL\x03\x01\0\0\0".to_vec();
    bytes.extend(sizes.into_iter().chain([1]).flat_map(i32::to_le_bytes));
    bytes.extend(
        [0.0_f32, 0.0, 0.0, 2.0, 1.0, 1.0]
            .into_iter()
            .flat_map(f32::to_le_bytes),
    );
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

fn folder(scene: &str) -> Folder {
    let vol = vol(&[1.0, 3.0], [2, 1, 1]);
    Folder::new(&[("a.xml", scene.as_bytes()), ("a.obj", OBJ), ("a.vol", &vol)])
}

fn load(scene: &str) -> Result<Scene> {
    Scene::load(&folder(scene).path("a.xml"))
}

/// A scene of a floor and this.
fn with(content: &str) -> Result<Scene> {
    load(&format!(
        "<scene version=\"3.0.0\">\n<shape type=\"rectangle\"/>\n{content}\n</scene>"
    ))
}

#[test]
fn cameras_and_lights_are_those_of_the_file() {
    let scene = load(SCENE).unwrap();
    assert_eq!((scene.film.width, scene.film.height), (40, 20));
    let [main, lens] = &scene.cameras[..] else {
        panic!("{:?}", scene.cameras);
    };
    assert_eq!((&*main.name, &*lens.name), ("main", "camera 2"));
    // Of 90 degrees down, a picture of twice that width has tan 2 across.
    assert!((main.fov_x_rad - 2.0 * 2_f32.atan()).abs() < 1e-5);
    assert!((main.origin() - Vec3::new(0.0, 1.0, 5.0)).length() < 1e-6);
    for camera in [main, lens] {
        let ahead = camera.scene_from_camera.transform_vector3(-Vec3::Z);
        let right = camera.scene_from_camera.transform_vector3(Vec3::X);
        assert!((ahead + Vec3::Z).length() < 1e-6 && (right - Vec3::X).length() < 1e-6);
    }
    let [point, spot, sun, sky] = &scene.lights[..] else {
        panic!("{:?}", scene.lights);
    };
    assert_eq!(
        *point,
        Light::Point {
            position: Vec3::new(0.0, 2.0, 0.0),
            intensity: [3.0; 3]
        }
    );
    let &Light::Spot {
        position,
        direction,
        intensity,
        cos_inner,
        cos_outer,
    } = spot
    else {
        panic!("{spot:?}");
    };
    assert_eq!(
        (position, intensity),
        (Vec3::new(0.0, 3.0, 0.0), [1.0, 2.0, 3.0])
    );
    assert!((direction + Vec3::Y).length() < 1e-6);
    let angles = [cos_inner, cos_outer].map(|c| c.acos().to_degrees());
    assert!(
        (angles[0] - 30.0).abs() < 1e-2 && (angles[1] - 40.0).abs() < 1e-2,
        "{angles:?}"
    );
    let parallel = Light::Directional {
        direction: -Vec3::Y,
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    };
    assert_eq!(*sun, parallel);
    assert_eq!(
        *sky,
        Light::Environment {
            radiance: [0.25; 3]
        }
    );
}

#[test]
fn shapes_and_media_are_in_place() {
    let scene = load(SCENE).unwrap();
    let of = |name: &str| {
        let at = scene.materials.iter().position(|m| m.name == name).unwrap();
        let triangles =
            (0..scene.mesh.triangles.len()).filter(|t| scene.mesh.material[*t] == at as u32);
        (&scene.materials[at], triangles.collect::<Vec<_>>())
    };
    let (floor, triangles) = of("floor");
    assert_eq!(floor.albedo, [0.5, 0.1, 0.2]);
    let up: Vec3 = triangles.iter().map(|t| scene.mesh.area_vector(*t)).sum();
    assert!((up - Vec3::Y * 16.0).length() < 1e-4, "{up}");
    let albedos: Vec<[f32; 3]> = scene.materials.iter().map(|m| m.albedo).collect();
    assert!(albedos.contains(&[1.0, 0.0, 0.0]));
    let lamp = scene
        .materials
        .iter()
        .find(|m| m.emission == [2.0; 3])
        .unwrap();
    assert_eq!((lamp.albedo, lamp.emits_both_sides), ([0.0; 3], false));
    // Floor, triangle, disk and two cubes; glass and null are left out.
    assert_eq!(scene.mesh.triangles.len(), 2 + 1 + 128 + 2 * 12);
    let [smoke, fog] = &scene.volumes[..] else {
        panic!("{} volumes", scene.volumes.len());
    };
    assert_eq!((&*smoke.name, smoke.albedo), ("smoke", [0.9, 0.8, 0.7]));
    assert_eq!(smoke.phase, PhaseFunction::henyey_greenstein(0.5));
    assert_eq!(
        (
            smoke.sigma_t.max(),
            smoke.sigma_t.sample(Vec3::new(0.5, 0.5, 0.5))
        ),
        (30.0, 10.0)
    );
    let (low, high) = (smoke.bounds().min, smoke.bounds().max);
    assert!(low.abs().max_element() < 1e-6 && (high - 1.0).abs().max_element() < 1e-6);
    assert_eq!((fog.sigma_t.max(), fog.albedo), (2.0, [0.5; 3]));
    assert!((fog.bounds().min + 1.0).abs().max_element() < 1e-6);
}

#[test]
fn thin_lenses_are_taken() {
    let lens = |scene: &str| load(scene).unwrap().cameras.pop().unwrap().lens;
    let of = |aperture, focus_distance| Lens::new(aperture, focus_distance);
    assert_eq!(lens(SCENE), of(0.1, 1e4));
    let radius = r#"<float name="aperture_radius" value="0.1"/>"#;
    let focus = |value: &str| {
        let focus = format!("{radius}<float name=\"focus_distance\" value=\"{value}\"/>");
        SCENE.replace(radius, &focus)
    };
    assert_eq!(lens(&focus("2.5")), of(0.1, 2.5));
    let error = load(&focus("-1")).unwrap_err().to_string();
    assert!(error.contains("focus_distance"), "{error}");
    let error = load(&SCENE.replace(radius, "")).unwrap_err().to_string();
    assert!(error.contains("aperture_radius"), "{error}");
    assert!(load(SCENE).unwrap().cameras[0].lens.is_none());
}

#[test]
fn what_is_left_out_is_told_with_its_line() {
    let scene = load(SCENE).unwrap();
    let told = scene.warnings.join("\n");
    for part in [
        "highlights are left out: line 16",
        "surfaces of glass are left out: line 23",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    assert_eq!(scene.warnings.len(), 2, "{told}");
    assert!(
        scene.notes.join("").contains("`max_depth` of 5"),
        "{:?}",
        scene.notes
    );
    let folder = folder(SCENE);
    let dir = folder.path("");
    let bake = ["bake", "a.xml", "-o", "a.lvc", "--surfels", "500"];
    lvox(&dir, &bake).done();
    fs::remove_file(folder.path("a.lvc")).unwrap();
    let strict = lvox(&dir, &[&bake[..], &["--strict"]].concat());
    assert_eq!(strict.code, 2, "{}", strict.stderr);
    assert!(
        strict.stderr.contains("error: 2 warnings with"),
        "{}",
        strict.stderr
    );
    assert!(!folder.path("a.lvc").exists());
    for (content, says) in [
        (
            "<shape type=\"sphere\"><bsdf type=\"diffuse\"><rgb name=\"reflectence\" value=\"1\"/>\
             </bsdf></shape>",
            "left out: `reflectence` of diffuse line 3",
        ),
        (
            "<shape type=\"serialized\"><string name=\"filename\" value=\"x\"/></shape>",
            "`serialized` are left out: line 3",
        ),
        (
            "<emitter type=\"sunsky\"/>",
            "`sunsky` are left out: line 3",
        ),
        (
            "<shape type=\"rectangle\"><bsdf type=\"mask\">\
             <texture type=\"vertexcolors\" name=\"opacity\"/><bsdf type=\"diffuse\"/></bsdf>\
             </shape>",
            "opacities of vertices are taken as 1: line 3",
        ),
    ] {
        let scene = with(content).unwrap();
        assert!(
            scene.warnings.iter().any(|w| w.contains(says)),
            "{says}: {:?}",
            scene.warnings
        );
    }
}

#[test]
fn masks_say_where_surfaces_are_there() {
    let texture = r#"<texture type="bitmap" name="opacity"><string name="filename" value="m.png"/>
      <boolean name="raw" value="true"/></texture>"#;
    let leaf = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.2 0.6 0.1"/></bsdf>"#;
    let masked = |opacity: &str| {
        format!(
            "<shape type=\"rectangle\" id=\"leaf\"><bsdf type=\"twosided\">\
             <bsdf type=\"mask\">{opacity}{leaf}</bsdf></bsdf></shape>"
        )
    };
    let load = |opacity: &str| {
        let scene = format!(
            "<scene version=\"3.0.0\"><shape type=\"rectangle\"/>{}</scene>",
            masked(opacity)
        );
        let folder = folder(&scene);
        let image =
            image::GrayImage::from_fn(8, 8, |x, _| image::Luma([if x < 4 { 0 } else { 255 }]));
        image.save(folder.path("m.png")).unwrap();
        Scene::load(&folder.path("a.xml")).unwrap()
    };
    let scene = load(texture);
    assert!(
        scene.warnings.iter().all(|w| !w.contains("mask")),
        "{:?}",
        scene.warnings
    );
    let leaf = scene.materials.iter().find(|m| m.name == "leaf").unwrap();
    let mask = leaf.mask.unwrap();
    assert_eq!((mask.opacity, mask.cutoff), (1.0, None));
    let opacity = &scene.textures[mask.texture.unwrap() as usize];
    assert_eq!(opacity.sample(Vec2::new(0.25, 0.5)), [0.0; 3]);
    let shares = load("<float name=\"opacity\" value=\"0.25\"/>");
    let leaf = shares.materials.iter().find(|m| m.name == "leaf").unwrap();
    assert_eq!(leaf.mask.unwrap().opacity, 0.25);
    // Nothing of it is left, or all of it is.
    let triangles = |opacity: &str| {
        load(&format!("<float name=\"opacity\" value=\"{opacity}\"/>"))
            .mesh
            .triangles
            .len()
    };
    assert_eq!((triangles("0"), triangles("1")), (2, 4));
}

#[test]
fn parameters_includes_and_older_names() {
    let scene = r#"<scene version="0.6.0"><path value="parts"/>
      <default name="size" value="3"/><default name="size_y" value="2"/>
      <include filename="parts/more.xml"/>
      <shape type="sphere"><transform name="toWorld"><scale x="$size" y="$size_y"/></transform></shape></scene>"#;
    let more = r#"<scene version="0.6.0"><bsdf type="diffuse" id="blue">
        <srgb name="diffuseReflectance" value="0, 0, 1"/></bsdf>
      <sensor type="perspective"><transform name="toWorld">
        <lookAt origin="0, 0, 9" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
      <shape type="obj" id="part"><string name="filename" value="b.obj"/><ref id="blue"/></shape></scene>"#;
    let folder = folder(scene);
    fs::create_dir(folder.path("parts")).unwrap();
    fs::write(folder.path("parts/more.xml"), more).unwrap();
    fs::write(folder.path("parts/b.obj"), OBJ).unwrap();
    let load = |changes: &[&str]| {
        let changes = changes.iter().map(|text| text.parse::<Change>());
        let settings = Settings {
            changes: changes.collect::<Result<_>>()?,
            ..Settings::default()
        };
        Scene::load_with(&folder.path("a.xml"), &settings, &Job::default())
    };
    let plain = load(&[]).unwrap();
    let size = |scene: &Scene| scene.bounds().max;
    assert!(
        (size(&plain) - Vec3::new(3.0, 2.0, 1.0)).length() < 1e-2,
        "{}",
        size(&plain)
    );
    assert!(
        plain
            .materials
            .iter()
            .any(|m| m.name == "part" && m.albedo == [0.0, 0.0, 1.0])
    );
    assert!((plain.cameras[0].origin().z - 9.0).abs() < 1e-6);
    let other = load(&["size=5"]).unwrap();
    assert!((size(&other) - Vec3::new(5.0, 2.0, 1.0)).length() < 1e-2);
    assert_ne!(plain.hash, other.hash);
    let error = load(&["sise=5"]).unwrap_err();
    assert!(
        error.to_string().contains("the scene has no $sise"),
        "{error}"
    );
    assert_eq!(error.hint_text(), Some("did you mean size?"));
    let files = lvox(&folder.path(""), &["farm", "files", "a.xml"]);
    assert_eq!(
        files.stdout, "a.xml\nparts/more.xml\nparts/b.obj\n",
        "{}",
        files.stderr
    );
}

#[test]
fn textures_lie_as_in_mitsuba() {
    // Two texels across, two down: red and green above blue and white.
    let png = image::RgbImage::from_fn(2, 2, |x, y| {
        image::Rgb([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255; 3]][(2 * y + x) as usize])
    });
    let texture = "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\">\
        <string name=\"filename\" value=\"a.png\"/><transform name=\"to_uv\">\
        <scale x=\"0.5\" y=\"1\"/></transform></texture></bsdf>";
    let folder = folder(&format!(
        "<scene version=\"3.0.0\"><shape type=\"rectangle\">{texture}</shape>\
         <shape type=\"obj\"><string name=\"filename\" value=\"a.obj\"/>{texture}</shape></scene>"
    ));
    png.save(folder.path("a.png")).unwrap();
    let scene = Scene::load(&folder.path("a.xml")).unwrap();
    let uv = |p: Vec3, m: u32| {
        let of = |t: &usize| scene.mesh.material[*t] == m;
        let mut triangles = (0..scene.mesh.triangles.len()).filter(of);
        let vertex = triangles.find_map(|t| {
            let found = scene.mesh.triangles[t]
                .iter()
                .find(|v| scene.mesh.positions[**v as usize] == p);
            found.copied()
        });
        scene.mesh.uvs[vertex.unwrap() as usize]
    };
    // v of a rectangle grows with y, and a texture's first row is at v = 0.
    assert_eq!(uv(Vec3::new(1.0, 1.0, 0.0), 0), Vec2::new(0.5, 1.0));
    assert_eq!(uv(Vec3::new(-1.0, -1.0, 0.0), 0), Vec2::ZERO);
    // Those of OBJ files are turned.
    assert_eq!(uv(Vec3::new(0.0, 1.0, 0.0), 1), Vec2::ZERO);
    assert_eq!(
        scene.textures[0].sample(Vec2::new(0.25, 0.25)),
        [1.0, 0.0, 0.0]
    );
}

#[test]
fn skies_are_turned_as_the_file_says() {
    // Light from +x, a quarter of the width before the middle.
    let texel = |x: i32, y: i32| match (x - 16).abs() < 3 && (y - 16).abs() < 3 {
        true => [1.0; 3],
        false => [0.1; 3],
    };
    let texels = (0..32).flat_map(|y| (0..64).map(move |x| image::Rgb(texel(x, y))));
    let mut hdr = Vec::new();
    let encoder = image::codecs::hdr::HdrEncoder::new(&mut hdr);
    encoder.encode(&texels.collect::<Vec<_>>(), 64, 32).unwrap();
    for (turn, towards) in [
        ("", Vec3::X),
        ("<rotate y=\"1\" angle=\"90\"/>", -Vec3::Z),
        ("<rotate z=\"1\" angle=\"90\"/>", Vec3::Y),
        (
            "<rotate x=\"1\" angle=\"90\"/><rotate y=\"1\" angle=\"90\"/>",
            -Vec3::Z,
        ),
    ] {
        let folder = folder(&format!(
            "<scene version=\"3.0.0\"><shape type=\"rectangle\"/><emitter type=\"envmap\">\
             <float name=\"scale\" value=\"2\"/><string name=\"filename\" value=\"a.hdr\"/>\
             <transform name=\"to_world\">{turn}</transform></emitter></scene>"
        ));
        fs::write(folder.path("a.hdr"), &hdr).unwrap();
        let scene = Scene::load(&folder.path("a.xml")).unwrap();
        let sky = scene.environment_image.unwrap();
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
            let expected = if axis == towards { 2.0 } else { 0.2 };
            let seen = sky.seen(axis).0[0];
            assert!((seen - expected).abs() < 0.02, "{turn}: {axis} {seen}");
        }
    }
}
