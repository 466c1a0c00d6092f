//! Where surfaces of a file are there, and where they emit.

use super::*;

/// A material of this alpha, with a texture of 2 x 1 texels, of which the second is clear, and
/// opacities of vertices.
fn masked(alpha: Value, has_alpha: bool) -> (Import, Vec<String>) {
    let (mut json, mut bin) = sample();
    let mut png = std::io::Cursor::new(Vec::new());
    let image: image::DynamicImage = match has_alpha {
        true => image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([9, 9, 9, 255 - 255 * x as u8]))
            .into(),
        false => image::RgbImage::new(2, 1).into(),
    };
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let colors = bin.len();
    for color in [
        [1.0, 1.0, 1.0, 1.0],
        [1.0, 1.0, 1.0, 0.25],
        [0.5, 1.0, 1.0, 2.0_f32],
    ] {
        bin.extend(color.iter().flat_map(|v| v.to_le_bytes()));
    }
    let uvs = bin.len();
    for uv in [[0.25_f32, 0.5], [0.75, 0.5], [0.25, 0.5]] {
        bin.extend(uv.iter().flat_map(|v| v.to_le_bytes()));
    }
    let start = bin.len();
    bin.extend(png.into_inner());
    let views = json["bufferViews"].as_array_mut().unwrap();
    for (from, to) in [(colors, uvs), (uvs, start), (start, bin.len())] {
        views.push(json!({ "buffer": 0, "byteOffset": from, "byteLength": to - from }));
    }
    let accessors = json["accessors"].as_array_mut().unwrap();
    accessors.push(json!({ "bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC4" }));
    accessors.push(json!({ "bufferView": 3, "componentType": 5126, "count": 3, "type": "VEC2" }));
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes["COLOR_0"] = json!(3);
    attributes["TEXCOORD_0"] = json!(4);
    json["images"] = json!([{ "bufferView": 4, "mimeType": "image/png" }]);
    json["textures"] = json!([{ "source": 0 }]);
    json["buffers"][0]["byteLength"] = json!(bin.len());
    let material = &mut json["materials"][0];
    material["emissiveFactor"] = json!([0.0, 0.0, 0.0]);
    material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    for (key, value) in alpha.as_object().unwrap() {
        match key.as_str() {
            "factor" => material["pbrMetallicRoughness"]["baseColorFactor"][3] = value.clone(),
            key => material[key] = value.clone(),
        }
    }
    let mut files = Files::default();
    let import = read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
    import.mesh.check().unwrap();
    (import, files.warnings)
}

#[test]
fn alpha_modes_say_where_surfaces_are_there() {
    let (import, told) = masked(
        json!({ "alphaMode": "MASK", "alphaCutoff": 0.3, "factor": 0.9 }),
        true,
    );
    assert!(told.is_empty(), "{told:?}");
    let mask = import.mesh.materials[0].mask.unwrap();
    assert_eq!((mask.opacity, mask.cutoff), (0.9, Some(0.3)));
    let alpha = &import.mesh.textures[mask.texture.unwrap() as usize];
    assert_eq!(alpha.texels().collect::<Vec<_>>(), [[1.0; 3], [0.0; 3]]);
    assert_eq!(import.mesh.opacities, [1.0, 0.25, 1.0]);
    let of = |alpha: Value, has_alpha: bool| {
        let (import, told) = masked(alpha, has_alpha);
        let told = told.join("; ");
        (
            import.mesh.materials[0].mask,
            import.mesh.textures.len(),
            told,
        )
    };
    let (mask, textures, told) = of(json!({ "alphaMode": "OPAQUE" }), true);
    assert_eq!((mask, textures, told.as_str()), (None, 1, ""));
    let (mask, _, told) = of(json!({ "alphaMode": "MASK" }), true);
    assert_eq!((mask.unwrap().cutoff, told.as_str()), (Some(0.5), ""));
    let (mask, _, told) = of(json!({ "alphaMode": "BLEND", "factor": 0.5 }), true);
    assert_eq!((mask.unwrap().opacity, mask.unwrap().cutoff), (0.5, None));
    assert!(
        told.contains("materials that blend are there in part: by their alpha"),
        "{told}"
    );
    let (mask, textures, told) = of(json!({ "alphaMode": "MASK" }), false);
    assert_eq!((mask.unwrap().texture, textures), (None, 1));
    assert!(
        told.contains("masks of textures without alpha leave all: `glow`"),
        "{told}"
    );
    let (mask, _, told) = of(json!({ "alphaMode": "MASK", "alphaCutoff": 7.0 }), true);
    assert_eq!(mask.unwrap().cutoff, Some(1.0));
    assert!(
        told.contains("`alphaCutoff` outside of [0,1] is brought into it: `glow`"),
        "{told}"
    );
}

#[test]
fn an_emissive_texture_is_a_factor_on_the_emission() {
    let (import, told) = masked(
        json!({ "emissiveFactor": [0.5, 1.0, 0.0], "emissiveTexture": { "index": 0 } }),
        false,
    );
    assert!(told.is_empty(), "{told:?}");
    let material = &import.mesh.materials[0];
    assert_eq!(material.emission, [3.0, 6.0, 0.0]);
    assert_eq!(
        (material.texture, material.emission_texture),
        (Some(0), Some(0))
    );
    assert_eq!(import.mesh.textures.len(), 1);
    // One that lies elsewhere than that of the colour cannot be drawn there.
    let elsewhere =
        json!({ "index": 0, "extensions": { "KHR_texture_transform": { "offset": [0.5, 0.0] } } });
    let (import, told) = masked(
        json!({ "emissiveFactor": [1.0, 1.0, 1.0], "emissiveTexture": elsewhere }),
        false,
    );
    let material = &import.mesh.materials[0];
    let mean = texture::mean(&import.mesh.textures[0]);
    assert_eq!(material.emission_texture, None);
    assert_eq!(material.emission, mean.map(|m| 6.0 * m));
    assert!(
        told.join("; ").contains("materials shine evenly"),
        "{told:?}"
    );
    // What does not shine needs no texture.
    let (import, told) = masked(json!({ "emissiveTexture": { "index": 0 } }), false);
    assert!(told.is_empty() && import.mesh.materials[0].emission_texture.is_none());
}

/// Older files state colours by another model.
#[test]
fn colours_beside_highlights_are_read() {
    let (mut json, bin) = sample();
    json["extensionsUsed"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    json["materials"][0]["extensions"] = json!({
        "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0.25, 0.5, 0.75, 1.0] }
    });
    let mut files = Files::default();
    let import = read(&glb(&json, &bin), Path::new("x.glb"), &mut files).unwrap();
    assert_eq!(import.mesh.materials[0].albedo, [0.25, 0.5, 0.75]);
    let told = files.warnings.iter().any(|w| w.contains("Glossiness"));
    assert!(!told, "{:?}", files.warnings);
}
