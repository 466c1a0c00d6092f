//! Files of other programs that Mitsuba scenes are made with.

use super::*;

#[test]
fn acceptance_scenes_are_those_of_toml() {
    if shared("refs/geom").is_none() {
        return;
    }
    for name in ["A", "B", "C"] {
        let toml = Scene::load(&acceptance(&format!("{name}.toml"))).unwrap();
        let volumes = tempfile::tempdir().unwrap();
        let volume = volumes.path().join("volume.vol");
        write_vol(name, &volume);
        let changes = match name {
            "B" => Vec::new(),
            _ => vec![Change {
                key: "volume".into(),
                value: volume.display().to_string(),
            }],
        };
        let settings = Settings {
            changes,
            ..Settings::default()
        };
        let xml = acceptance(&format!("{name}.xml"));
        let xml = Scene::load_with(&xml, &settings, &Job::default()).unwrap();
        assert_eq!(xml.warnings, Vec::<String>::new(), "{name}");
        assert_eq!(xml.mesh.positions[..], toml.mesh.positions[..], "{name}");
        assert_eq!(xml.mesh.triangles[..], toml.mesh.triangles[..], "{name}");
        assert!(xml.mesh.normals.is_empty() && toml.mesh.normals.is_empty());
        let looks = |scene: &Scene| -> Vec<_> {
            let material = |m: &u32| &scene.materials[*m as usize];
            scene
                .mesh
                .material
                .iter()
                .map(|m| (material(m).albedo, material(m).emission))
                .collect()
        };
        assert_eq!(looks(&xml), looks(&toml), "{name}");
        assert_eq!(xml.lights, toml.lights, "{name}");
        assert_eq!(
            (xml.film.width, xml.film.height),
            (toml.film.width, toml.film.height)
        );
        let cameras = [&xml.cameras[0], &toml.cameras[0]];
        let maps = cameras.map(|camera| camera.scene_from_camera);
        assert!(maps[0].abs_diff_eq(maps[1], 1e-6), "{name}: {maps:?}");
        assert!((cameras[0].fov_x_rad - cameras[1].fov_x_rad).abs() < 1e-6);
        assert_eq!(xml.volumes.len(), toml.volumes.len());
        for (a, b) in xml.volumes.iter().zip(&toml.volumes) {
            assert_eq!(
                (a.albedo, a.phase, a.sigma_t.dims()),
                (b.albedo, b.phase, b.sigma_t.dims())
            );
            let corners = [a.corners(), b.corners()];
            let apart = corners[0]
                .iter()
                .zip(&corners[1])
                .map(|(p, q)| (*p - *q).length());
            assert!(apart.fold(0.0, f32::max) < 1e-5, "{corners:?}");
            let size = Vec3::from(a.sigma_t.size());
            for i in 0..1000 {
                let f = [i % 10, i / 10 % 10, i / 100].map(|k| (k as f32 + 0.37) / 10.0);
                let p = Vec3::from(f) * size;
                let (x, y) = (a.sigma_t.sample(p), b.sigma_t.sample(p));
                assert!((x - y).abs() <= 1e-5 * y.abs().max(1.0), "{name}: {x} {y}");
            }
        }
    }
}

/// The volume of an acceptance scene as Mitsuba reads it.
fn write_vol(name: &str, path: &Path) {
    let geometry = shared("refs/geom").unwrap();
    let values: Vec<f32> = match name {
        "A" => {
            let raw = fs::read(geometry.join("smoke64.raw")).unwrap();
            raw.chunks_exact(4)
                .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
                .collect()
        }
        "C" => {
            let nrrd = fs::read(geometry.join("bunny_density_128.nrrd")).unwrap();
            let start = nrrd.windows(2).position(|w| w == b"\n\n").unwrap() + 2;
            let mut bytes = Vec::new();
            let mut unpacked = flate2::read::GzDecoder::new(&nrrd[start..]);
            std::io::Read::read_to_end(&mut unpacked, &mut bytes).unwrap();
            bytes.into_iter().map(|v| f32::from(v) / 255.0).collect()
        }
        _ => return,
    };
    let side = (values.len() as f64).cbrt().round() as i32;
    fs::write(path, vol(&values, [side; 3])).unwrap();
}

#[test]
fn vol_files_are_volumes_of_toml_scenes_and_by_themselves() {
    let folder = folder("<scene/>");
    let scene = folder
        .load("[[volume]]\nfile = \"a.vol\"\nsigma_t_scale = 2\nalbedo = [1, 1, 1]\n")
        .unwrap();
    assert_eq!(scene.volumes[0].bounds().max, Vec3::new(2.0, 1.0, 1.0));
    assert_eq!(scene.volumes[0].sigma_t.max(), 6.0);
    let told = lvox(&folder.path(""), &["inspect", "a.vol"]);
    assert_eq!(told.code, 0, "{}", told.stderr);
    assert!(told.stdout.contains("2 x 1 x 1"), "{}", told.stdout);
    fs::write(folder.path("a.vol"), "VOLUME").unwrap();
    lvox(&folder.path(""), &["inspect", "a.vol"]).refused(2, &["begins with VOL"]);
}

#[test]
fn a_bitmap_is_the_radiance_of_a_light_on_a_shape() {
    let image =
        image::RgbImage::from_fn(2, 2, |x, y| image::Rgb([255 * x as u8, 255 * y as u8, 255]));
    let light = |radiance: &str, bsdf: &str| {
        let scene = format!(
            "<scene version=\"3.0.0\"><shape type=\"rectangle\">{bsdf}\
             <emitter type=\"area\">{radiance}</emitter></shape></scene>"
        );
        let folder = folder(&scene);
        image.save(folder.path("m.png")).unwrap();
        Scene::load(&folder.path("a.xml")).unwrap()
    };
    let bitmap = |name: &str, more: &str| {
        format!(
            "<texture type=\"bitmap\" name=\"{name}\">\
             <string name=\"filename\" value=\"m.png\"/>{more}</texture>"
        )
    };
    let scene = light(&bitmap("radiance", ""), "");
    let material = &scene.materials[0];
    assert_eq!((material.emission, material.albedo), ([1.0; 3], [0.0; 3]));
    assert_eq!(material.emission_texture, Some(0));
    assert!(
        !scene.warnings.iter().any(|w| w.contains("radiance")),
        "{:?}",
        scene.warnings
    );
    // One that lies as that of the colour does, and one that does not.
    let diffuse = |more: &str| {
        format!(
            "<bsdf type=\"diffuse\">{}</bsdf>",
            bitmap("reflectance", more)
        )
    };
    let scene = light(&bitmap("radiance", ""), &diffuse(""));
    assert_eq!(scene.materials[0].emission_texture, Some(1));
    let moved = "<transform name=\"to_uv\"><scale x=\"2\" y=\"2\"/></transform>";
    let scene = light(&bitmap("radiance", ""), &diffuse(moved));
    let material = &scene.materials[0];
    assert_eq!(
        (material.emission_texture, material.emission),
        (None, [0.5, 0.5, 1.0])
    );
    assert!(
        scene
            .warnings
            .iter()
            .any(|w| w.contains("taken as their mean")),
        "{:?}",
        scene.warnings
    );
}
