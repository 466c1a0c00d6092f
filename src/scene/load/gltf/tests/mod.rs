//! Small glTF files written here, and what becomes of them.

mod looks;

use super::*;
use serde_json::{Value, json};

/// A triangle with a node above it, a camera, and lights of all kinds; one buffer of 36 + 36 + 6
/// bytes.
fn sample() -> (Value, Vec<u8>) {
    let mut bin: Vec<u8> = Vec::new();
    for x in [[0_f32, 0., 0.], [1., 0., 0.], [0., 1., 0.]] {
        bin.extend(x.iter().flat_map(|v| v.to_le_bytes()));
    }
    for _ in 0..3 {
        bin.extend([0_f32, 0., 1.].iter().flat_map(|v| v.to_le_bytes()));
    }
    bin.extend([0_u16, 1, 2].iter().flat_map(|v| v.to_le_bytes()));
    bin.extend([0, 0]);
    let json = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
        "extensions": { "KHR_lights_punctual": { "lights": [
            { "type": "point", "intensity": 4.0, "color": [1.0, 0.5, 0.0] },
            { "type": "spot", "intensity": 2.0,
              "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } },
            { "type": "directional", "intensity": 3.0 },
        ] } },
        "scene": 0,
        "scenes": [{ "nodes": [0, 2, 3, 4] }],
        "nodes": [
            { "name": "up", "translation": [0.0, 10.0, 0.0], "children": [1] },
            { "mesh": 0, "scale": [2.0, 2.0, 2.0] },
            { "camera": 0, "translation": [0.0, 0.0, 5.0], "scale": [3.0, 3.0, 3.0],
              "extensions": { "KHR_lights_punctual": { "light": 0 } } },
            { "rotation": [-0.5, 0.0, 0.0, 0.5], "translation": [1.0, 2.0, 3.0],
              "extensions": { "KHR_lights_punctual": { "light": 1 } } },
            { "extensions": { "KHR_lights_punctual": { "light": 2 } } },
        ],
        "cameras": [{ "type": "perspective",
            "perspective": { "yfov": 0.8, "znear": 0.1, "aspectRatio": 2.0 } }],
        "materials": [{ "name": "glow", "doubleSided": true,
            "emissiveFactor": [0.5, 1.0, 0.0],
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 6.0 } },
            "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 1.0] } }],
        "meshes": [{ "primitives": [{ "material": 0, "indices": 2,
            "attributes": { "POSITION": 0, "NORMAL": 1 } }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
              "min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0] },
            { "bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 72 },
            { "buffer": 0, "byteOffset": 72, "byteLength": 6 },
        ],
        "buffers": [{ "byteLength": bin.len() }],
    });
    (json, bin)
}

fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + text.len() + 8 + bin.len();
    let mut out = b"glTF".to_vec();
    out.extend([2, length as u32].iter().flat_map(|n| n.to_le_bytes()));
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}

fn load(content: &[u8]) -> Result<Import> {
    read(content, Path::new("x.glb"), &mut Files::default())
}

#[test]
fn nodes_materials_cameras_and_lights_arrive_in_place() {
    let (json, bin) = sample();
    let import = load(&glb(&json, &bin)).unwrap();
    let mesh = &import.mesh;
    mesh.check().unwrap();
    assert_eq!(mesh.positions[2], DVec3::new(0.0, 12.0, 0.0));
    assert_eq!(mesh.normals[0], Vec3::Z);
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    let material = &mesh.materials[0];
    assert_eq!(material.albedo, [0.1, 0.2, 0.3]);
    assert_eq!(material.emission, [3.0, 6.0, 0.0]);
    assert!(material.emits_both_sides);
    assert_eq!(
        import.lights[0].light,
        Light::Point {
            position: Vec3::ZERO,
            intensity: [4.0, 2.0, 0.0]
        }
    );
    assert_eq!(import.lights[0].position, DVec3::new(0.0, 0.0, 5.0));
    let Light::Spot {
        direction,
        cos_outer,
        ..
    } = import.lights[1].light
    else {
        panic!("{:?}", import.lights[1].light)
    };
    assert!((direction - Vec3::NEG_Y).length() < 1e-6, "{direction}");
    assert_eq!(cos_outer, 0.5_f32.cos());
    let scene = import.into_scene(Path::new("a/x.glb")).unwrap();
    assert_eq!(scene.film.unwrap().height, 320);
    let camera = &scene.cameras[0];
    assert_eq!(camera.world_from_camera.matrix3, DMat3::IDENTITY);
    let expected = 2.0 * (0.4_f64.tan() * 2.0).atan();
    assert!((camera.fov_x_rad - expected).abs() < 1e-6);
}

#[test]
fn strips_fans_sparse_and_packed_attributes_are_read() {
    let (mut json, bin) = sample();
    json["meshes"][0]["primitives"][0]["mode"] = json!(5);
    assert_eq!(load(&glb(&json, &bin)).unwrap().mesh.triangles.len(), 1);
    json["meshes"][0]["primitives"][0]["mode"] = json!(6);
    assert_eq!(load(&glb(&json, &bin)).unwrap().mesh.triangles, [[0, 1, 2]]);
    // Vertex 2 is moved to where vertex 1 is.
    json["accessors"][0]["sparse"] = json!({ "count": 1,
        "indices": { "bufferView": 1, "byteOffset": 4, "componentType": 5123 },
        "values": { "bufferView": 0, "byteOffset": 12 } });
    let mesh = load(&glb(&json, &bin)).unwrap().mesh;
    assert_eq!(mesh.positions[2], DVec3::new(2.0, 10.0, 0.0));
}

/// The sample with an image of four colours on its triangle, whose corners have the texture
/// coordinates (0,0), (1,0), (0,1), and another set in which all are (0.25, 0.25).
fn textured() -> (Value, Vec<u8>) {
    let (mut json, mut bin) = sample();
    let image =
        image::RgbImage::from_fn(2, 2, |x, y| image::Rgb([255 * x as u8, 255 * y as u8, 0]));
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let uvs = [
        [0.0_f32, 0.0],
        [1.0, 0.0],
        [0.0, 1.0],
        [0.25; 2],
        [0.25; 2],
        [0.25; 2],
    ];
    let at = bin.len();
    bin.extend(uvs.iter().flatten().flat_map(|v| v.to_le_bytes()));
    bin.extend(png.get_ref());
    let push = |list: &mut Value, value: Value| list.as_array_mut().unwrap().push(value);
    push(
        &mut json["bufferViews"],
        json!({ "buffer": 0, "byteOffset": at, "byteLength": 48 }),
    );
    let png = json!({ "buffer": 0, "byteOffset": at + 48, "byteLength": png.get_ref().len() });
    push(&mut json["bufferViews"], png);
    for offset in [0, 24] {
        let accessor = json!({ "bufferView": 2, "byteOffset": offset, "componentType": 5126,
            "count": 3, "type": "VEC2" });
        push(&mut json["accessors"], accessor);
    }
    json["buffers"][0]["byteLength"] = json!(bin.len());
    json["images"] = json!([{ "bufferView": 3, "mimeType": "image/png" }]);
    json["textures"] = json!([{ "source": 0 }]);
    json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes["TEXCOORD_0"] = json!(3);
    attributes["TEXCOORD_1"] = json!(4);
    (json, bin)
}

#[test]
fn texture_transforms_are_applied() {
    let (mut json, bin) = textured();
    let uvs = |json: &Value| load(&glb(json, &bin)).unwrap().mesh.uvs;
    assert_eq!(uvs(&json), [Vec2::ZERO, Vec2::X, Vec2::Y]);
    // The lower left quarter of the image, turned clockwise: the example of the extension's
    // description.
    let transform = |json: &mut Value, transform: Value| {
        json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
            json!({ "KHR_texture_transform": transform });
    };
    transform(
        &mut json,
        json!({ "offset": [0.0, 1.0], "rotation": std::f32::consts::FRAC_PI_2, "scale": [0.5, 0.5] }),
    );
    let expected = [
        Vec2::new(0.0, 1.0),
        Vec2::new(0.0, 0.5),
        Vec2::new(0.5, 1.0),
    ];
    for (found, expected) in uvs(&json).into_iter().zip(expected) {
        assert!((found - expected).length() < 1e-6, "{found} {expected}");
    }
    transform(
        &mut json,
        json!({ "texCoord": 1, "offset": [0.5, 0.0], "scale": [2.0, 1.0] }),
    );
    assert_eq!(uvs(&json), [Vec2::new(1.0, 0.25); 3]);
}

#[test]
fn samplers_say_what_is_beyond_the_border() {
    let (mut json, bin) = textured();
    let beyond = |json: &Value| {
        let mesh = load(&glb(json, &bin)).unwrap().mesh;
        let texture = &mesh.textures[mesh.materials[0].texture.unwrap() as usize];
        [Vec2::new(1.25, 0.25), Vec2::new(0.25, 1.25)].map(|uv| {
            let [r, g, _] = texture.sample(uv);
            [r, g]
        })
    };
    assert_eq!(beyond(&json), [[0.0, 0.0], [0.0, 0.0]]);
    json["textures"][0]["sampler"] = json!(0);
    json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 10497 }]);
    assert_eq!(beyond(&json), [[1.0, 0.0], [0.0, 0.0]]);
    json["samplers"] = json!([{ "wrapS": 10497, "wrapT": 33648 }]);
    assert_eq!(beyond(&json), [[0.0, 0.0], [0.0, 1.0]]);
    // One image in two ways is two textures.
    json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 10497 }, {}]);
    json["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 0, "sampler": 1 }]);
    let mut other = json["materials"][0].clone();
    other["pbrMetallicRoughness"]["baseColorTexture"]["index"] = json!(1);
    json["materials"].as_array_mut().unwrap().push(other);
    let mut primitive = json["meshes"][0]["primitives"][0].clone();
    primitive["material"] = json!(1);
    json["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(primitive);
    let mesh = load(&glb(&json, &bin)).unwrap().mesh;
    let wraps: Vec<_> = mesh.textures.iter().map(|t| t.wrap[0]).collect();
    assert_eq!(wraps, [Wrap::Clamp, Wrap::Repeat]);
}

#[test]
fn extensions_of_looks_that_are_not_read_are_named_once() {
    let (mut json, bin) = sample();
    let warnings = |json: &Value| {
        let mut files = Files::default();
        read(&glb(json, &bin), Path::new("x.glb"), &mut files).unwrap();
        files.warnings
    };
    assert_eq!(warnings(&json), [] as [String; 0]);
    json["extensionsUsed"] = json!([
        "KHR_lights_punctual",
        "KHR_texture_transform",
        "KHR_materials_transmission",
        "KHR_xmp_json_ld",
        "ACME_fur"
    ]);
    let said = warnings(&json);
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].starts_with("x.glb: extensions are left out"));
    assert!(said[0].ends_with(": KHR_materials_transmission, ACME_fur"));
    // As Blender writes a material without highlights.
    let name = "KHR_materials_specular";
    json["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_texture_transform", name]);
    for (extension, told) in [
        (json!({ "specularFactor": 0.0 }), 0),
        (json!({ "specularFactor": 0.5 }), 1),
        (json!({}), 1),
    ] {
        json["materials"][0]["extensions"] = json!({ name: extension });
        assert_eq!(warnings(&json).len(), told, "{extension}");
    }
}

#[test]
fn required_extensions_are_no_reason_to_refuse_what_can_be_drawn() {
    let (mut json, bin) = sample();
    for name in [
        "KHR_mesh_quantization",
        "KHR_materials_unlit",
        "KHR_materials_variants",
        "KHR_materials_clearcoat",
        "KHR_xmp_json_ld",
        "MSFT_lod",
        "EXT_mesh_gpu_instancing",
    ] {
        json["extensionsRequired"] = json!([name]);
        json["extensionsUsed"] = json!([name]);
        load(&glb(&json, &bin)).unwrap();
    }
    for name in [
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "ACME_fur",
    ] {
        json["extensionsRequired"] = json!([name]);
        let e = load(&glb(&json, &bin)).map(drop).unwrap_err();
        let expected = format!("the file requires the extension {name}, which is not read");
        assert_eq!(e.to_string(), expected);
        assert!(e.hint_text().is_some());
    }
}

#[test]
fn what_others_write_against_the_standard_is_read() {
    let (mut json, bin) = sample();
    for accessor in json["accessors"].as_array_mut().unwrap() {
        let accessor = accessor.as_object_mut().unwrap();
        accessor.remove("min");
        accessor.remove("max");
    }
    assert_eq!(load(&glb(&json, &bin)).unwrap().mesh.triangles.len(), 1);
    json["nodes"][1]["extensions"] = json!({ "KHR_node_visibility": { "visible": false } });
    assert!(load(&glb(&json, &bin)).unwrap().mesh.triangles.is_empty());
    json["scenes"] = json!([{}]);
    assert!(load(&glb(&json, &bin)).unwrap().mesh.triangles.is_empty());
    json["asset"]["version"] = json!("1.0");
    let message = load(&glb(&json, &bin)).map(drop).unwrap_err().to_string();
    assert!(
        message.contains("expected glTF of version 2.0, found \"1.0\""),
        "{message}"
    );
}

#[test]
fn metal_and_normal_maps_are_summed_up_in_a_line() {
    let (json, bin) = sample();
    let warnings = |material: Value| {
        let mut json = json.clone();
        json["images"] = json!([{ "uri": "data:image/png;base64,AAAA" }]);
        json["textures"] = json!([{ "source": 0 }]);
        json["materials"].as_array_mut().unwrap().push(material);
        let mut files = Files::default();
        read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
        files.warnings
    };
    let told = "x.glb: all surfaces are taken as diffuse; of 2 materials this leaves out";
    let smooth = json!({ "pbrMetallicRoughness": { "roughnessFactor": 0.2 } });
    assert_eq!(warnings(smooth), [format!("{told} metal of 1")]);
    let both = json!({
        "normalTexture": { "index": 0 },
        "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 } }
    });
    let expected = format!("{told} metal of 1, bumps and normal maps of 1");
    assert_eq!(warnings(both), [expected]);
    for plain in [
        json!({}),
        json!({ "pbrMetallicRoughness": {} }),
        json!({ "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0 } }),
    ] {
        assert_eq!(warnings(plain), [] as [String; 0]);
    }
}

#[test]
fn what_moves_meshes_and_is_left_out_is_said() {
    let (mut json, bin) = sample();
    json["skins"] = json!([{ "joints": [0] }]);
    json["animations"] = json!([{ "channels": [], "samplers": [] }]);
    let position = json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
    json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": position }]);
    let mut files = Files::default();
    read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
    assert_eq!(
        files.warnings,
        [
            "x.glb: motion is left out, meshes and nodes are where they are without: \
             skins, morph targets, animations"
        ]
    );
}

#[test]
fn a_texture_of_no_image_is_wrong_only_where_it_is_used() {
    let (mut json, bin) = sample();
    json["textures"] = json!([{ "source": 3 }]);
    load(&glb(&json, &bin)).unwrap();
    json["materials"][0]["emissiveTexture"] = json!({ "index": 0 });
    let mut files = Files::default();
    read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
    let [told] = &files.warnings[..] else {
        panic!("{:?}", files.warnings)
    };
    assert!(told.starts_with("x.glb: textures that cannot be read are left out: image 0"));
}

#[test]
fn wrong_files_are_refused_with_the_place() {
    let message = |change: &dyn Fn(&mut Value)| {
        let (mut json, bin) = sample();
        change(&mut json);
        load(&glb(&json, &bin)).map(|_| ()).unwrap_err().to_string()
    };
    let cycle = message(&|j| j["nodes"][1]["children"] = json!([0]));
    assert!(cycle.contains("two parents"), "{cycle}");
    let beyond = message(&|j| j["accessors"][0]["count"] = json!(4_000_000_000_u32));
    assert!(
        beyond.contains("accessor 0: 4000000000 elements"),
        "{beyond}"
    );
    let stride = message(&|j| j["bufferViews"][0]["byteStride"] = json!(4));
    assert!(stride.contains("4 apart"), "{stride}");
    let count = message(&|j| j["accessors"][1]["count"] = json!(2));
    assert!(count.contains("expected 3 normals"), "{count}");
    let spot = message(&|j| {
        j["extensions"]["KHR_lights_punctual"]["lights"][1]["spot"]["innerConeAngle"] = json!(0.6);
    });
    assert!(spot.contains("inner must be smaller"), "{spot}");
    let dark = message(&|j| {
        j["extensions"]["KHR_lights_punctual"]["lights"][0]["intensity"] = json!(-1.0);
    });
    assert!(dark.ends_with("expected 0 to 1e30"), "{dark}");
    let buffer = message(&|j| j["buffers"][0]["uri"] = json!("http://x/y"));
    assert!(
        buffer.contains("buffer 0: expected a file beside"),
        "{buffer}"
    );
    let (json, mut bin) = sample();
    bin[76] = 3;
    let loose = load(&glb(&json, &bin)).map(|_| ()).unwrap_err().to_string();
    assert!(
        loose.contains("node 1: primitive 0: triangle 0 refers to the vertices [0, 1, 3]"),
        "{loose}"
    );
}

/// Calls `visit` with a copy of the document for each value in it, that value taken out or
/// replaced.
fn each_damage(json: &Value, visit: &mut dyn FnMut(&Value)) {
    fn paths(value: &Value, at: String, out: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                for (key, inner) in map {
                    paths(inner, format!("{at}/{key}"), out);
                }
            }
            Value::Array(list) => {
                for (i, inner) in list.iter().enumerate() {
                    paths(inner, format!("{at}/{i}"), out);
                }
            }
            _ => {}
        }
        out.push(at);
    }
    let mut all = Vec::new();
    paths(json, String::new(), &mut all);
    for path in all.iter().filter(|p| !p.is_empty()) {
        for value in [
            json!(null),
            json!(0),
            json!(-1),
            json!(7),
            json!(5125),
            json!(u64::MAX),
            json!(1e300),
            json!("text"),
            json!([]),
            json!({}),
        ] {
            let mut damaged = json.clone();
            *damaged.pointer_mut(path).unwrap() = value;
            visit(&damaged);
        }
        let (parent, key) = path.rsplit_once('/').unwrap();
        let mut damaged = json.clone();
        match damaged.pointer_mut(parent) {
            Some(Value::Object(map)) => {
                map.remove(key);
            }
            Some(Value::Array(list)) => {
                list.remove(key.parse().unwrap());
            }
            _ => {}
        }
        visit(&damaged);
    }
}

#[test]
fn damage_is_an_error_or_harmless_but_never_a_panic() {
    let (json, bin) = sample();
    let finish = |import: Result<Import>| {
        if let Ok(import) = import
            && let Ok(scene) = import.into_scene(Path::new("x.glb"))
        {
            let _ = scene.finish(&crate::run::Cancel::default());
        }
    };
    each_damage(&json, &mut |damaged| finish(load(&glb(damaged, &bin))));
    let content = glb(&json, &bin);
    for cut in 0..content.len() {
        finish(load(&content[..cut]));
    }
    for at in 0..content.len() {
        for flip in [1, 2, 0x80, 0xff] {
            let mut damaged = content.clone();
            damaged[at] ^= flip;
            finish(load(&damaged));
        }
    }
}

/// The sample with its mesh at so many listed places, of which the second is flattened.
fn listed(counts: [u32; 2]) -> (Value, Vec<u8>) {
    let (mut json, mut bin) = sample();
    let mut list = |values: Vec<f32>, count: u32| {
        let (offset, length) = (bin.len(), 4 * values.len());
        bin.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        json["buffers"][0]["byteLength"] = json!(bin.len());
        let views = json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
        let view = views.len() - 1;
        let accessors = json["accessors"].as_array_mut().unwrap();
        let entry =
            json!({ "bufferView": view, "componentType": 5126, "count": count, "type": "VEC3" });
        accessors.push(entry);
        accessors.len() - 1
    };
    let places = (0..counts[0]).flat_map(|i| [3.0 * i as f32, 0.0, 0.0]);
    let places = list(places.collect(), counts[0]);
    let sizes = (0..counts[1]).flat_map(|i| [1.0, if i == 1 { 0.0 } else { 1.0 }, 1.0]);
    let sizes = list(sizes.collect(), counts[1]);
    let lists = json!({ "TRANSLATION": places, "SCALE": sizes, "_ID": 77 });
    json["nodes"][1]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": lists } });
    (json, bin)
}

#[test]
fn meshes_stand_at_all_places_that_a_node_lists() {
    let (json, bin) = listed([4, 4]);
    let mut files = Files::default();
    let import = read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
    let mesh = import.mesh;
    mesh.check().unwrap();
    // So few triangles are flat.
    assert!(mesh.copies.is_empty());
    let first: Vec<DVec3> = mesh
        .triangles
        .iter()
        .map(|t| mesh.positions[t[0] as usize])
        .collect();
    let expected = [0.0, 12.0, 18.0].map(|x| DVec3::new(x, 10.0, 0.0));
    assert_eq!(first, expected);
    assert_eq!(
        files.warnings,
        ["x.glb: instances that are scaled to nothing are left out: 1"]
    );
    for (counts, says) in [([4, 3], "unlike lengths"), ([0, 0], "")] {
        let (json, bin) = listed(counts);
        match load(&glb(&json, &bin)) {
            Ok(import) => assert!(import.mesh.is_empty() && says.is_empty()),
            Err(error) => assert!(error.to_string().contains(says), "{error}"),
        }
    }
    let (mut json, bin) = listed([4, 4]);
    let lists = &mut json["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"];
    lists["attributes"]["ROTATION"] = json!(99);
    let error = load(&glb(&json, &bin)).map(drop).unwrap_err().to_string();
    assert!(error.contains("there is no accessor 99"), "{error}");
}

#[test]
fn places_that_are_not_finite_are_told_and_left_out() {
    let told = |json: &Value, bin: &[u8]| {
        let mut files = Files::default();
        let import = read(&glb(json, bin), Path::new("x.glb"), &mut files).unwrap();
        (import.mesh.triangles.len(), files.warnings)
    };
    // JSON has no word for it, but numbers that are beyond f32.
    for (key, value) in [
        ("rotation", json!([1e39, 0.0, 0.0, 1.0])),
        ("translation", json!([1e39, 0.0, 0.0])),
    ] {
        let (mut json, bin) = sample();
        json["nodes"][1][key] = value;
        let expected = "x.glb: nodes whose places are not finite are left out: node 1";
        assert_eq!(told(&json, &bin), (0, vec![expected.into()]), "{key}");
    }
    for (key, kind, values) in [
        ("ROTATION", "VEC4", [f32::NAN, 0.0, 0.0, 1.0].as_slice()),
        ("TRANSLATION", "VEC3", &[0.0, f32::NAN, 0.0]),
        ("SCALE", "VEC3", &[1.0, 1.0, f32::INFINITY]),
    ] {
        let (mut json, mut bin) = sample();
        let offset = bin.len();
        bin.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        json["buffers"][0]["byteLength"] = json!(bin.len());
        let view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": 4 * values.len() });
        json["bufferViews"].as_array_mut().unwrap().push(view);
        let accessor = json!({ "bufferView": 2, "componentType": 5126, "count": 1, "type": kind });
        json["accessors"].as_array_mut().unwrap().push(accessor);
        let list = json!({ "attributes": { key: 3 } });
        json["nodes"][1]["extensions"] = json!({ "EXT_mesh_gpu_instancing": list });
        let expected = "x.glb: instances whose places are not finite are left out: 1";
        assert_eq!(told(&json, &bin), (0, vec![expected.into()]), "{key}");
    }
}
