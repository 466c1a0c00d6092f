//! Every format of meshes and volumes, written here and read back.

mod grids;

use crate::{Folder, load};
use flate2::{Compression, write::GzEncoder};
use glam::{DVec3, Vec2, Vec3};
use lvox::scene::{Light, Scene};
use std::io::{Cursor, Write};

/// A triangle in ASCII with everything that a vertex can have.
const ASCII_PLY: &[u8] = b"ply\nformat ascii 1.0\ncomment x\nelement vertex 3\n\
property float x\nproperty float y\nproperty double z\n\
property float nx\nproperty float ny\nproperty float nz\n\
property uchar red\nproperty uchar green\nproperty uchar blue\n\
property float u\nproperty float v\nproperty int skipped\n\
element face 1\nproperty list uchar int vertex_indices\nend_header\n\
0 0 0 0 0 2 255 0 128 0 0 -7\n1 0 0 0 0 2 255 0 128 1 0 -7\n0 1 0.5 0 0 2 255 0 128 0 1 -7\n\
3 0 1 2\n";

fn mesh(file: &str, more: &str) -> String {
    format!("[[mesh]]\nfile = \"{file}\"\n{more}\n")
}

#[test]
fn ascii_ply_has_positions_normals_colours_and_uvs() {
    let scene = load(&mesh("a.ply", ""), &[("a.ply", ASCII_PLY)]).unwrap();
    let mesh = &scene.mesh;
    assert_eq!(mesh.positions[2], Vec3::new(0.0, 1.0, 0.5));
    assert_eq!(mesh.normals, [Vec3::Z; 3]);
    let half = 0.215_861;
    assert!((mesh.colors[0][2] - half).abs() < 1e-5, "sRGB is decoded");
    assert_eq!(mesh.colors[0][..2], [1.0, 0.0]);
    assert!(mesh.uvs.is_empty(), "nothing is textured");
    assert_eq!(scene.materials[0].albedo, [1.0; 3]);
}

#[test]
fn binary_ply_in_both_byte_orders_is_cut_into_fans_and_coloured_by_face() {
    for little in [true, false] {
        let order = |bytes: [u8; 4]| match little {
            true => bytes,
            false => [bytes[3], bytes[2], bytes[1], bytes[0]],
        };
        let name = if little { "little" } else { "big" };
        let mut ply = format!(
            "ply\nformat binary_{name}_endian 1.0\nelement vertex 4\nproperty float x\n\
             property float y\nproperty float z\nelement face 2\n\
             property list uchar uint vertex_index\nproperty float red\nproperty float green\n\
             property float blue\nproperty uchar material_index\nend_header\n"
        )
        .into_bytes();
        for p in [[0.0_f32, 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]] {
            ply.extend(p.iter().flat_map(|x| order(x.to_le_bytes())));
        }
        for (polygon, red, material) in
            [(vec![0_u32, 1, 2, 3], 0.25_f32, 1), (vec![0, 1, 2], 0.5, 0)]
        {
            ply.push(polygon.len() as u8);
            ply.extend(polygon.iter().flat_map(|i| order(i.to_le_bytes())));
            ply.extend([red, 0.0, 1.0].iter().flat_map(|c| order(c.to_le_bytes())));
            ply.push(material);
        }
        let linear = "color_encoding = \"linear\"";
        let scene = load(&mesh("a.ply", linear), &[("a.ply", &ply)]).unwrap();
        assert_eq!(scene.mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(scene.mesh.material, [0, 0, 1]);
        assert_eq!(scene.materials[0].albedo, [0.25, 0.0, 1.0]);
        assert!(scene.mesh.normals.is_empty() && scene.mesh.colors.is_empty());

        let palette = "palette = [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]";
        let scene = load(&mesh("a.ply", palette), &[("a.ply", &ply)]).unwrap();
        assert_eq!(scene.materials[0].albedo, [0.2; 3]);
        assert_eq!(scene.materials[1].albedo, [0.1; 3]);
        let e = load(&mesh("a.ply", "palette = [[0, 0, 0]]"), &[("a.ply", &ply)]).unwrap_err();
        assert!(e.to_string().contains("beyond the palette of 1"), "{e}");
    }
}

#[test]
fn a_colour_is_the_same_in_every_format() {
    let obj = b"v 0 0 0 0.2 0.6 1\nv 1 0 0 0.2 0.6 1\nv 0 1 0 0.2 0.6 1\nf 1 2 3\n";
    let ply = |kind: &str, color: &str| {
        let corners = ["0 0 0", "1 0 0", "0 1 0"].map(|p| format!("{p} {color}\n"));
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
             property float z\nproperty {kind} red\nproperty {kind} green\nproperty {kind} blue\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n{}3 0 1 2\n",
            corners.concat()
        )
    };
    let (bytes, doubles) = (ply("uchar", "51 153 255"), ply("double", "0.2 0.6 1"));
    let files: [(&str, &[u8]); 3] = [
        ("a.obj", obj),
        ("b.ply", bytes.as_bytes()),
        ("d.ply", doubles.as_bytes()),
    ];
    for (name, content) in files {
        let scene = load(&mesh(name, ""), &[(name, content)]).unwrap();
        assert_eq!(scene.materials[0].albedo, [1.0; 3], "{name}");
        let [r, g, b] = scene.mesh.colors[0];
        assert!((r - 0.033_104_8).abs() < 1e-5, "{name}: {r}");
        assert!(
            (g - 0.318_546_8).abs() < 1e-5 && b == 1.0,
            "{name}: {g} {b}"
        );
    }
}

#[test]
fn textures_that_a_ply_names_are_drawn() {
    let head = "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 3\n\
                property float x\nproperty float y\nproperty float z\n";
    let of_vertices = format!(
        "{head}property float texture_u\nproperty float texture_v\nelement face 1\n\
         property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n\
         3 0 1 2\n"
    );
    let of_corners = format!(
        "{head}element face 2\nproperty list uchar int vertex_indices\n\
         property list uchar float texcoord\nproperty int texnumber\nend_header\n0 0 0\n1 0 0\n\
         0 1 0\n3 0 1 2 6 0 0 1 0 0 1 0\n3 2 1 0 6 0.5 0 1 0 0 0 0\n"
    );
    for ply in [of_vertices, of_corners] {
        let files: [(&str, &[u8]); 2] = [("a.ply", ply.as_bytes()), ("t.png", &png())];
        let scene = load(&mesh("a.ply", ""), &files).unwrap();
        assert_eq!(scene.materials[0].texture, Some(0));
        assert_eq!(scene.materials[0].albedo, [1.0; 3]);
        assert_eq!(scene.mesh.uvs[2], Vec2::new(0.0, 0.0));
        let told = scene.warnings.iter().any(|w| w.contains("texture"));
        assert!(!told, "{:?}", scene.warnings);
        // A vertex with other coordinates in another face is split.
        if scene.mesh.triangles.len() == 2 {
            assert_eq!(scene.mesh.triangles[1], [3, 1, 0]);
            assert_eq!(scene.mesh.uvs[3], Vec2::new(0.5, 1.0));
        }
    }
}

#[test]
fn what_a_texture_is_lacking_is_no_reason_to_draw_nothing() {
    let obj = b"mtllib x.mtl b c.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nusemtl a\n\
                f 1/1 2/2 3/1\n";
    let mtl = b"newmtl a\nKd 0.25 0.5 1\nmap_Kd no.png\n";
    let files: [(&str, &[u8]); 2] = [("a.obj", obj), ("b c.mtl", mtl)];
    let scene = load(&mesh("a.obj", ""), &files).unwrap();
    assert_eq!(scene.materials[0].albedo, [0.25, 0.5, 1.0]);
    assert_eq!(scene.materials[0].texture, None);
    let told = |what: &str| scene.warnings.iter().any(|w| w.contains(what));
    assert!(
        told("x.mtl is not there") && told("`no.png`"),
        "{:?}",
        scene.warnings
    );

    let mtl = b"newmtl a\nmap_Kd -s 2 1 -o 0.5 0 T.PNG\n";
    let files: [(&str, &[u8]); 3] = [("a.obj", obj), ("b c.mtl", mtl), ("t.png", &png())];
    let scene = load(&mesh("a.obj", ""), &files).unwrap();
    assert_eq!(scene.materials[0].texture, Some(0));
    assert_eq!(scene.mesh.uvs[1], Vec2::new(2.5, 1.0));
}

#[test]
fn a_black_kd_hides_no_texture() {
    let obj = b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nusemtl a\nf 1/1 2/2 3/1\n";
    for (mtl, albedo) in [
        ("Kd 0 0 0\nmap_Kd t.png\n", 1.0),
        ("map_Kd t.png\nKd 0 0 0\n", 1.0),
        ("map_Kd t.png\nKd 0.5\n", 0.5),
    ] {
        let mtl = format!("newmtl a\n{mtl}");
        let files: [(&str, &[u8]); 3] =
            [("a.obj", obj), ("x.mtl", mtl.as_bytes()), ("t.png", &png())];
        let scene = load(&mesh("a.obj", ""), &files).unwrap();
        assert_eq!(scene.materials[0].albedo, [albedo; 3], "{mtl}");
        let told = scene.warnings.iter().any(|w| w.contains("a black `Kd`"));
        assert_eq!(told, albedo == 1.0, "{mtl}");
    }
}

#[test]
fn a_map_ke_says_where_a_material_shines() {
    let obj = b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nusemtl a\nf 1/1 2/2 3/1\n";
    for (mtl, emission, told) in [
        ("map_Ke t.png\n", [1.0; 3], ""),
        ("Ke 5\nmap_Ke -s 2 1 1 t.png\n", [5.0; 3], ""),
        (
            "map_Ke t.png\nKe 5 4 3\nmap_Kd t.png\n",
            [5.0, 4.0, 3.0],
            "",
        ),
        (
            "Ke 0 0 0\nmap_Ke t.png\n",
            [1.0; 3],
            "a black `Ke` beside a `map_Ke` is taken as 1: `a`",
        ),
        ("map_Ke t.png\nKe 0 0 0\n", [1.0; 3], "a black `Ke` beside"),
        (
            "Ke 2\nmap_Kd t.png\nmap_Ke -s 2 2 2 t.png\n",
            [2.0; 3],
            "a `map_Ke` lies where the `map_Kd` of its material does: `a`",
        ),
    ] {
        let mtl = format!("newmtl a\n{mtl}");
        let files: [(&str, &[u8]); 3] =
            [("a.obj", obj), ("x.mtl", mtl.as_bytes()), ("t.png", &png())];
        let scene = load(&mesh("a.obj", ""), &files).unwrap();
        let material = &scene.materials[0];
        assert_eq!(material.emission, emission, "{mtl}");
        assert!(material.emission_texture.is_some(), "{mtl}");
        assert_eq!(scene.textures.len(), 1);
        let of_ke: Vec<_> = scene.warnings.iter().filter(|w| w.contains("Ke")).collect();
        match told {
            "" => assert!(of_ke.is_empty(), "{mtl}: {of_ke:?}"),
            told => assert!(
                of_ke.len() == 1 && of_ke[0].contains(told),
                "{mtl}: {of_ke:?}"
            ),
        }
    }
    // Without texture coordinates the mean stands for it.
    let plain = b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n";
    let mtl = b"newmtl a\nKe 2\nmap_Ke t.png\n";
    let files: [(&str, &[u8]); 3] = [("a.obj", plain), ("x.mtl", mtl), ("t.png", &png())];
    let scene = load(&mesh("a.obj", ""), &files).unwrap();
    assert_eq!(scene.materials[0].emission, [1.0, 2.0, 0.0]);
    assert!(scene.textures.is_empty() && scene.materials[0].emission_texture.is_none());
}

#[test]
fn a_scene_file_gives_a_mesh_a_texture_of_emission() {
    let quad = "[[mesh]]\nfile = \"builtin:quad\"\n";
    let of = |more: &str| load(&format!("{quad}{more}"), &[("t.png", &png())]);
    let scene = of("emission_texture = \"t.png\"").unwrap();
    assert_eq!(scene.materials[0].emission, [1.0; 3]);
    assert_eq!(scene.materials[0].emission_texture, Some(0));
    assert!(
        !scene.warnings.iter().any(|w| w.contains("no light")),
        "{:?}",
        scene.warnings
    );
    let scene =
        of("emission = [3, 2, 1]\nemission_texture = \"t.png\"\ntexture = \"t.png\"").unwrap();
    assert_eq!(scene.materials[0].emission, [3.0, 2.0, 1.0]);
    assert!(scene.textures[0].shares_texels(&scene.textures[1]));
    let ply = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                property float z\nelement face 1\nproperty list uchar int vertex_indices\n\
                end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let files: [(&str, &[u8]); 2] = [("a.ply", ply), ("t.png", &png())];
    let error = load(&mesh("a.ply", "emission_texture = \"t.png\""), &files).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("the mesh has no texture coordinates"),
        "{error}"
    );
}

#[test]
fn an_empty_part_is_left_out_and_an_empty_scene_refused() {
    let part = mesh("a.obj", "");
    let cube = "[[mesh]]\nfile = \"builtin:cube\"\n";
    let files: [(&str, &[u8]); 1] = [("a.obj", b"v 0 0 0\n")];
    let scene = load(&format!("{cube}{part}"), &files).unwrap();
    assert_eq!(scene.mesh.triangles.len(), 12);
    assert!(
        scene
            .warnings
            .iter()
            .any(|w| w.contains("no faces were found"))
    );
    assert!(load(&part, &files).is_err());
}

fn png() -> Vec<u8> {
    let image = image::RgbImage::from_fn(2, 1, |x, _| image::Rgb([255 * x as u8, 255, 0]));
    let mut png = Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    png.into_inner()
}

#[test]
fn obj_brings_materials_and_textures() {
    let obj = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0.5\nvt 0.75 0.5\n\
usemtl lamp\nf 1 2 3\nusemtl tiles\nf 1/1 2/2 3/1\n";
    let mtl = b"newmtl tiles\nKd 0.5 0.5 0.5\nmap_Kd tiles.png\nnewmtl lamp\nKe 4 5 6\n";
    let files: [(&str, &[u8]); 3] = [("a.obj", obj), ("m.mtl", mtl), ("tiles.png", &png())];
    let scene = load(&mesh("a.obj", ""), &files).unwrap();
    let of = |t: usize| &scene.materials[scene.mesh.material[t] as usize];
    assert_eq!(of(0).emission, [4.0, 5.0, 6.0]);
    assert_eq!(of(1).albedo, [0.5; 3]);
    let texture = &scene.textures[of(1).texture.unwrap() as usize];
    let uv = scene.mesh.triangles[1].map(|i| scene.mesh.uvs[i as usize]);
    assert_eq!(texture.sample(uv[0]), [0.0, 1.0, 0.0]);
    assert_eq!(texture.sample(uv[1]), [1.0, 1.0, 0.0]);
    assert!(scene.warnings.iter().all(|w| w.contains("no camera")));
}

#[test]
fn a_texture_without_coordinates_becomes_its_mean() {
    let obj = b"mtllib m.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let mtl = b"newmtl a\nmap_Kd tiles.png\n";
    let files: [(&str, &[u8]); 3] = [("a.obj", obj), ("m.mtl", mtl), ("tiles.png", &png())];
    let scene = load(&mesh("a.obj", ""), &files).unwrap();
    assert_eq!(scene.materials[0].albedo, [0.5, 1.0, 0.0]);
    assert_eq!(scene.materials[0].texture, None);
    assert!(scene.warnings[0].contains("no texture coordinates"));
}

#[test]
fn keys_override_what_the_file_says() {
    let files: [(&str, &[u8]); 2] = [("a.ply", ASCII_PLY), ("t.png", &png())];
    let text = mesh("a.ply", "albedo = [0.1, 0.2, 0.3]\nnormals = \"face\"");
    let scene = load(&text, &files).unwrap();
    assert_eq!(scene.materials[0].albedo, [0.1, 0.2, 0.3]);
    assert!(scene.mesh.colors.is_empty() && scene.mesh.normals.is_empty());

    let text = mesh(
        "a.ply",
        "texture = \"t.png\"\nemission = [1, 2, 3]\nemits_both_sides = true\nvisible = false\n\
         name = \"n\"",
    );
    let scene = load(&text, &files).unwrap();
    assert_eq!(scene.materials[0].emission, [1.0, 2.0, 3.0]);
    assert!(scene.materials[0].emits_both_sides && !scene.materials[0].is_seen);
    assert_eq!(scene.materials[0].name, "n");
    assert_eq!(scene.mesh.uvs[0], Vec2::new(0.0, 1.0), "v runs downwards");
    assert_eq!(scene.textures.len(), 1);

    let scene = load(&mesh("builtin:cube", "normals = { crease_deg = 120 }"), &[]).unwrap();
    let n = scene.mesh.normals[0];
    let p = scene.mesh.positions[0];
    assert!(n.dot(p) > 0.5, "smooth over the edges");
    let scene = load(&mesh("builtin:sphere", ""), &[]).unwrap();
    assert_eq!(
        scene.mesh.normals.len(),
        scene.mesh.positions.len(),
        "given by default"
    );
}

#[test]
fn cameras_and_lights_are_placed() {
    let text = "[film]\nwidth = 200\nheight = 100\nexposure = 2\n\
[[camera]]\nname = \"a\"\nposition = [1, 2, 3]\ntarget = [1, 2, -3]\nfov_x_deg = 90\n\
[[camera]]\ncamera_to_world = [[0, 0, 1, 5], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]\n\
[[light]]\ntype = \"point\"\nposition = [0, 1, 0]\nintensity = [1, 2, 3]\n\
[[light]]\ntype = \"spot\"\nposition = [0, 1, 0]\ntarget = [0, 0, 0]\nintensity = [1, 1, 1]\n\
inner_deg = 10\nouter_deg = 60\n\
[[light]]\ntype = \"directional\"\ndirection = [0, -2, 0]\nirradiance = [1, 1, 1]\n\
angular_radius_deg = 0.5\n\
[[light]]\ntype = \"environment\"\nradiance = [0.5, 0.5, 1]\n";
    let scene = load(&(text.to_string() + &mesh("builtin:cube", "")), &[]).unwrap();
    assert!(scene.warnings.is_empty());
    assert_eq!(scene.film.exposure, 2.0);
    assert_eq!(scene.cameras[0].origin(), Vec3::new(1.0, 2.0, 3.0));
    let right = scene.cameras[0].direction(&scene.film, 200.0, 50.0);
    assert!((right - Vec3::new(1.0, 0.0, -1.0).normalize()).length() < 1e-6);
    assert_eq!(scene.cameras[1].name, "camera 2");
    let ahead = scene.cameras[1].direction(&scene.film, 100.0, 50.0);
    assert!((ahead - Vec3::NEG_X).length() < 1e-6, "{ahead}");
    assert_eq!(scene.lights.len(), 4);
    let Light::Spot {
        direction,
        cos_outer,
        ..
    } = scene.lights[1]
    else {
        panic!("{:?}", scene.lights)
    };
    assert_eq!(direction, Vec3::NEG_Y);
    assert!((cos_outer - 0.5).abs() < 1e-6);
    let Light::Directional {
        angular_radius_rad, ..
    } = scene.lights[2]
    else {
        panic!("{:?}", scene.lights)
    };
    assert!((angular_radius_rad - 0.5_f32.to_radians()).abs() < 1e-9);
}

/// Values of a 4 x 3 x 2 grid: 0 to 23, x fastest.
fn values() -> impl Iterator<Item = u8> {
    0..24
}

fn sample(scene: &Scene, world: DVec3) -> f32 {
    let volume = &scene.volumes[0];
    let p = world - scene.world_from_scene;
    let index = volume.index_from_scene.transform_point3(p.as_vec3());
    volume.sigma_t.sample(index)
}

#[test]
fn a_scene_far_from_the_origin_is_the_same_scene() {
    let at = |x: f64| {
        let text = format!(
            "[[camera]]\nposition = [{x}, 0, 5]\ntarget = [{x}, 0, 0]\n\
             [[light]]\ntype = \"point\"\nposition = [{x}, 2, 0]\nintensity = [1, 1, 1]\n\
             [[mesh]]\nfile = \"builtin:sphere\"\ntranslate = [{x}, 0, 0]\n\
             [[volume]]\nfile = \"builtin:plume\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n\
             translate = [{x}, 0, 0]\nunitcube_to_world = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"
        );
        load(&text, &[]).unwrap()
    };
    let (near, far) = (at(0.0), at(1e6));
    assert_eq!(near.world_from_scene, DVec3::ZERO);
    assert!((far.world_from_scene.x - 1e6).abs() < 1.0);
    let shift = (far.world_from_scene - DVec3::new(1e6, 0.0, 0.0)).as_vec3();
    for (a, b) in near.mesh.positions.iter().zip(&far.mesh.positions) {
        assert!((*a - *b - shift).length() < 1e-6);
    }
    assert!((near.cameras[0].origin() - far.cameras[0].origin() - shift).length() < 1e-6);
    for p in [DVec3::splat(0.4), DVec3::new(0.5, 0.1, 0.52)] {
        let moved = p + DVec3::new(1e6, 0.0, 0.0);
        assert!((sample(&near, p) - sample(&far, moved)).abs() < 1e-3);
    }
}

#[test]
fn the_hash_follows_the_content_of_every_file() {
    let mut raw: Vec<u8> = values().collect();
    let text = "[[mesh]]\nfile = \"a.ply\"\n[[volume]]\nfile = \"a.raw\"\ndims = [4, 3, 2]\n\
dtype = \"u8\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n\
world_from_index = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    let hash = |text: &str, ply: &[u8], raw: &[u8]| {
        let files: [(&str, &[u8]); 2] = [("a.ply", ply), ("a.raw", raw)];
        load(text, &files).unwrap().hash
    };
    let first = hash(text, ASCII_PLY, &raw);
    assert_eq!(first, hash(text, ASCII_PLY, &raw), "wherever the folder is");
    assert_ne!(first, hash(&format!("# note\n{text}"), ASCII_PLY, &raw));
    let moved = String::from_utf8(ASCII_PLY.to_vec())
        .unwrap()
        .replace("0.5", "0.6");
    assert_ne!(first, hash(text, moved.as_bytes(), &raw));
    raw[5] += 1;
    assert_ne!(first, hash(text, ASCII_PLY, &raw));
}

/// A glTF in text, its buffer in a data URI: one triangle, a camera and a light.
const GLTF: &str = r#"{
 "asset": { "version": "2.0" }, "extensionsUsed": ["KHR_lights_punctual"],
 "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": 2 }] } },
 "scene": 0, "scenes": [{ "nodes": [0, 1] }],
 "nodes": [{ "mesh": 0 }, { "name": "eye", "camera": 0, "translation": [0, 0, 5],
  "extensions": { "KHR_lights_punctual": { "light": 0 } } }],
 "cameras": [{ "type": "perspective", "perspective": { "yfov": 1, "znear": 0.1 } }],
 "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
 "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
  "min": [0, 0, 0], "max": [1, 1, 0] }],
 "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
 "buffers": [{ "byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }]
}"#;

#[test]
fn a_gltf_is_a_scene_by_itself_or_a_mesh_in_one() {
    let folder = Folder::new(&[("x.gltf", GLTF.as_bytes())]);
    let scene = Scene::load(&folder.path("x.gltf")).unwrap();
    assert_eq!(scene.name, "x");
    assert_eq!(scene.mesh.positions[1], Vec3::X);
    assert_eq!(scene.cameras[0].name, "eye");
    assert_eq!(scene.lights.len(), 1);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);

    let scene = folder
        .load(&mesh("x.gltf", "translate = [0, 1, 0]"))
        .unwrap();
    assert_eq!(scene.cameras[0].name, "default");
    assert_eq!(scene.warnings.len(), 2);
    let all = "translate = [0, 1, 0]\nscale = 2\nimport = [\"cameras\", \"lights\"]";
    let scene = folder.load(&mesh("x.gltf", all)).unwrap();
    assert_eq!(scene.mesh.positions[1], Vec3::new(2.0, 1.0, 0.0));
    assert_eq!(scene.cameras[0].origin(), Vec3::new(0.0, 1.0, 10.0));
    let Light::Point { position, .. } = scene.lights[0] else {
        panic!("{:?}", scene.lights)
    };
    assert_eq!(position, Vec3::new(0.0, 1.0, 10.0));
    let scaled = folder.load(&mesh("x.gltf", &format!("{all}\nlight_scale = 0.5")));
    let source = |scene: &Scene| scene.lights[0].point_source().unwrap().1;
    assert_eq!(source(&scaled.unwrap()), source(&scene).map(|x| 0.5 * x));
    let error = folder
        .load(&mesh("x.gltf", "light_scale = 0.5"))
        .unwrap_err();
    assert!(error.to_string().contains("no `import"), "{error}");
}

/// A `map_d` of an image with alpha, and of one that is grey; `d` is a factor on both.
#[test]
fn masks_of_mtl_are_alpha_or_grey() {
    let obj = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl leaf\n\
                f 1/1 2/2 3/3\nusemtl net\nf 1/1 3/3 2/2\n";
    let toml = b"[[mesh]]\nfile = \"a.obj\"\n";
    let mtl = b"newmtl leaf\nmap_Kd leaf.png\nmap_d leaf.png\nnewmtl net\nd 0.5\nmap_d grey.png\n";
    let folder = Folder::new(&[("a.obj", obj), ("a.mtl", mtl), ("a.toml", toml)]);
    let there = |x: u32| if x < 4 { 0 } else { 255 };
    let leaf = image::RgbaImage::from_fn(8, 8, |x, _| image::Rgba([90, 80, 70, there(x)]));
    leaf.save(folder.path("leaf.png")).unwrap();
    let grey = image::GrayImage::from_fn(8, 8, |x, _| image::Luma([there(x) / 5]));
    grey.save(folder.path("grey.png")).unwrap();
    let scene = Scene::load(&folder.path("a.toml")).unwrap();
    let mask = |name: &str| {
        let material = scene.materials.iter().find(|m| m.name == name).unwrap();
        let mask = material.mask.unwrap();
        let texture = &scene.textures[mask.texture.unwrap() as usize];
        let seen = [0.25, 0.75].map(|u| texture.sample(Vec2::new(u, 0.5))[0]);
        (mask.opacity, mask.cutoff, seen)
    };
    assert_eq!(mask("leaf"), (1.0, None, [0.0, 1.0]));
    assert_eq!(mask("net"), (0.5, None, [0.0, 0.2]));
    assert!(
        scene
            .warnings
            .iter()
            .any(|w| w.contains("`d` below 1 are there in part"))
    );
}
