//! Statements of MTL files, their options, and what is told of them.

use super::*;

#[test]
fn materials_are_read_in_order() {
    let text = "# c\nKd 1 1 1\nnewmtl a\n Kd 0.1 0.2 0.3\nKe 5\nNs 10\nnewmtl b b\n";
    let library = read(text.as_bytes(), Path::new("x.mtl"), &mut Files::default());
    let materials = library.unwrap().materials;
    assert_eq!(materials.len(), 2);
    assert_eq!(materials[0].albedo, [0.1, 0.2, 0.3]);
    assert_eq!(materials[0].emission, [5.0; 3]);
    assert_eq!(materials[1], Material::diffuse("b b", DEFAULT_ALBEDO));
}

#[test]
fn what_changes_looks_and_is_left_out_is_said_once() {
    let text = "newmtl glass\nd 0.2\nmap_d a.png\nnewmtl leaf\nd 1\nnewmtl wall\nd 7\nKe 1\n";
    let mut files = Files::default();
    let library = read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
    assert_eq!(
        files.warnings,
        [
            "x.mtl: materials with `d` below 1 are there in part: they reflect that share of light \
             and let the rest through: `glass`",
            "x.mtl: textures that are not there are left out: `a.png`",
            "x.mtl: `d` outside of [0,1] is brought into it: line 7"
        ]
    );
    let masks: Vec<_> = library.materials.iter().map(|m| m.mask).collect();
    let glass = Mask {
        opacity: 0.2,
        texture: None,
        cutoff: None,
    };
    assert_eq!(masks, [Some(glass), None, None]);
    let mut files = Files::default();
    let text = "newmtl screen\nmap_Ke a.png\n";
    let library = read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
    assert_eq!(
        files.warnings,
        ["x.mtl: textures that are not there are left out: `a.png`"]
    );
    assert!(!library.materials[0].emits());
}

#[test]
fn transparency_is_read_where_there_is_no_dissolve() {
    let opacities = |text: &str| {
        let mut files = Files::default();
        let library = read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
        let opacity = |m: &Material| m.mask.map_or(1.0, |mask| mask.opacity);
        let all: Vec<f32> = library.materials.iter().map(opacity).collect();
        (all, files.warnings)
    };
    let (all, warnings) = opacities("newmtl a\nTr 0.75\nnewmtl b\nnewmtl c\ntr 0.5 0.5 0.5\n");
    assert_eq!(all, [0.25, 1.0, 0.5]);
    let [told] = &warnings[..] else {
        panic!("{warnings:?}");
    };
    assert!(told.ends_with("let the rest through: `a`, `c`"), "{told}");
    // However exporters mean it, `d` says it; and nobody writes what is not there at all.
    for opaque in [
        "Tr 0",
        "Tr 1",
        "d 1\nTr 0",
        "Tr 1\nd 1",
        "Tr 0.4\nd 1",
        "Tr x",
    ] {
        let found = opacities(&format!("newmtl a\n{opaque}\n"));
        assert_eq!(found, (vec![1.0], Vec::new()), "{opaque}");
    }
    for quarter in ["Tr 0.75\nd 0.25", "d 0.25\nTr 0.25"] {
        let (all, warnings) = opacities(&format!("newmtl a\n{quarter}\n"));
        assert_eq!((&all[..], warnings.len()), (&[0.25][..], 1), "{quarter}");
    }
}

#[test]
fn what_is_not_diffuse_is_summed_up_in_a_line() {
    let warnings = |text: &str| {
        let mut files = Files::default();
        read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
        files.warnings
    };
    let text = "newmtl a\nillum 5\nNi 1.5\nnewmtl b\nillum 7\nTf 1 1 1\nmap_Bump -bm 1 b.png\n\
                bump b.png\nnewmtl c\nKs 0.9 0.6 0.1\nillum 2\nnewmtl d\nillum 4\nnewmtl e\nPm 1\n\
                Pc 0.2\n";
    assert_eq!(
        warnings(text),
        [
            "x.mtl: all surfaces are taken as diffuse; of 5 materials this leaves out mirrors of \
             1, glass of 2, metal of 1, highlights of 1, clear coats of 1, \
             bumps and normal maps of 1"
        ]
    );
    for seen in [
        "map_Ks a.png",
        "refl a.png",
        "Ks 1 1 1",
        "illum 10",
        "illum 3\nKs 0.1",
        "disp a.png",
    ] {
        assert_eq!(warnings(&format!("newmtl a\n{seen}\n")).len(), 1, "{seen}");
    }
    // What exporters write for anything.
    for plain in [
        "Ns 250\nKa 1 1 1\nKs 0.5 0.5 0.5\nKe 0 0 0\nNi 1.45\nd 1\nillum 2",
        "Ns 10\nNi 1.5\nd 1\nTr 0\nTf 1 1 1\nillum 2\nKs 0 0 0",
        "Pr 0.5\nPm 0\nPs 0\nPc 0\nPcr 0.03\naniso 0\nanisor 0",
        "Ks 0 0 0\nillum 3",
        "Ks 1 1 1\nmap_Ks a.png\nillum 1",
        "Ka 0.2 0.2 0.2\nKs 1 1 1\nTr 1\nillum 2\nNs 0",
        "Ks 0 0 0\nmap_Ks a.png",
    ] {
        assert_eq!(
            warnings(&format!("newmtl a\n{plain}\n")),
            [] as [String; 0],
            "{plain}"
        );
    }
}

#[test]
fn a_wrong_colour_names_its_line() {
    let library = read(
        b"newmtl a\nKd 1 2",
        Path::new("x.mtl"),
        &mut Files::default(),
    );
    let message = library.unwrap_err().to_string();
    assert!(message.starts_with("line 2: expected a colour of one or three"));
}

#[test]
fn what_is_out_of_range_or_not_there_is_mended_and_told() {
    let text = "\u{feff}NEWMTL a\nKD 1.5 0.5 -1\nMAP_KD -s 1 1 1 my tile.png\nKe nan 1 1\n\
                newmtl b\nmap_Kd x.png\nmap_Kd -imfchan r x.png\nKd xyz 1 1 1\n";
    let mut files = Files::default();
    let library = read(text.as_bytes(), Path::new("m/x.mtl"), &mut files).unwrap();
    let [a, b] = &library.materials[..] else {
        panic!()
    };
    assert_eq!((a.albedo, a.emission), ([1.0, 0.5, 0.0], [0.0, 1.0, 1.0]));
    assert_eq!(
        (a.texture, b.texture, b.albedo),
        (None, None, DEFAULT_ALBEDO)
    );
    assert_eq!(
        files.warnings,
        [
            "m/x.mtl: `Kd` outside of [0,1] is brought into it: line 2",
            "m/x.mtl: textures that are not there are left out: `my tile.png`, `x.png`",
            "m/x.mtl: `Ke` below 0 or beyond any light is brought into range: line 4",
            "m/x.mtl: the choice of a channel is left out: `r`",
            "m/x.mtl: colours as spectra or XYZ are left out: line 8",
        ]
    );
}

#[test]
fn options_of_a_texture_are_read() {
    let map = |text| TextureMap::parse(text, &mut LeftOut::default());
    let plain = |name| TextureMap {
        name,
        uv_map: UvMap::IDENTITY,
        wrap: [Wrap::Repeat; 2],
        decoding: Decoding::default(),
    };
    for text in [
        "a b.png",
        "-bm 2 a b.png",
        "-colorspace sRGB -cc on a b.png",
    ] {
        assert_eq!(map(text), plain("a b.png"), "{text}");
    }
    assert_eq!(map("-1.png"), plain("-1.png"));
    assert_eq!(map("-s"), plain(""));
    let moved = map("-s 2 3 1 -o 0.5 1.png");
    assert_eq!(moved.uv_map.scale, Vec2::new(2.0, 3.0));
    assert_eq!(moved.uv_map.offset, Vec2::new(0.5, 0.0));
    assert_eq!(moved.name, "1.png");
    let map = map("-CLAMP on -mm 0.25 0.5 -colorspace linear a.png");
    assert_eq!(map.wrap, [Wrap::Clamp; 2]);
    let expected = Decoding {
        encoding: ColorEncoding::Linear,
        base: 0.25,
        gain: 0.5,
    };
    assert_eq!(map.decoding, expected);
}
