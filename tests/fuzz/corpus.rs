//! Small whole files of every format.

use flate2::{Compression, write::GzEncoder, write::ZlibEncoder};
use image::{DynamicImage, ImageFormat, RgbImage};
use lvox::image::{Frame, Layer, Region, exr};
use std::io::{Cursor, Write};

pub const OBJ: &str = "mtllib a.mtl\no room\nv 0 0 0\nv 1 0 0\nv 1 1 0 .5 .5 .5\nv 0 1 0\n\
v 0.5 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nusemtl red\nf 1/1/1 2/2/1 3/3/1\ng side\nusemtl glow\n\
f -4//1 -2//1 4//1\ns 1\nf 1 2 3 5 4\n";

pub const MTL: &str = "# two\nnewmtl red\nKd 0.8 0.1 0.1\nKa 0 0 0\nillum 2\n\
map_Kd -s 2 2 1 -clamp on a.png\nnewmtl glow\nKe 4 4 3\nKd .5 .5 .5\nd 1.0\nNs 10\n";

const TRIANGLE: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.2, 0.9, 0.4],
];

/// Points with normals, and without.
pub fn npy() -> Vec<Vec<u8>> {
    let of = |descr: &str, columns: usize, numbers: &[u8]| {
        let text =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2, {columns}), }}\n");
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend((text.len() as u16).to_le_bytes());
        file.extend(text.bytes());
        file.extend(numbers);
        file
    };
    let [normals, alone] = [[0.5_f32, 0.5, 0.5, 0.0, 1.0, 0.0], [0.5; 6]];
    let twice = [normals, normals].concat();
    let bytes: Vec<u8> = twice.iter().flat_map(|v| v.to_le_bytes()).collect();
    let alone: Vec<u8> = alone
        .iter()
        .flat_map(|v| f64::from(*v).to_be_bytes())
        .collect();
    vec![of("<f4", 6, &bytes), of(">f8", 3, &alone)]
}

/// Surfels of other programs, in floats and in bytes.
pub fn surfels() -> Vec<Vec<u8>> {
    let of = |size: &str, kind: &str| {
        let mut text = "ply\nformat ascii 1.0\nelement vertex 2\n".to_owned();
        for name in ["x", "y", "z", "nx", "ny", "nz", size] {
            text += &format!("property float {name}\n");
        }
        for name in ["red", "green", "blue"] {
            text += &format!("property {kind} {name}\n");
        }
        text += "end_header\n0 1 2 0 0.6 0.8 0.1 7 8 9\n1 1 3 0 0 1 0.2 1 0 1\n";
        text.into_bytes()
    };
    vec![of("radius", "double"), of("area", "uchar")]
}

pub fn ply() -> Vec<Vec<u8>> {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
             property float y\nproperty float z\nproperty float nx\nproperty float ny\n\
             property float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
             element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let faces: [&[i32]; 2] = [&[0, 1, 2], &[0, 1, 3, 2]];
    let mut text = header("ascii");
    for [x, y, z] in TRIANGLE {
        text += &format!("{x} {y} {z} 0 0 1 9 99 199\n");
    }
    for face in faces {
        let corners: Vec<String> = face.iter().map(i32::to_string).collect();
        text += &format!("{} {}\n", face.len(), corners.join(" "));
    }
    let binary = |format: &str, is_big: bool| {
        let mut out = header(format).into_bytes();
        let word = |out: &mut Vec<u8>, bytes: [u8; 4]| {
            out.extend(if is_big {
                bytes.into_iter().rev().collect::<Vec<_>>()
            } else {
                bytes.to_vec()
            });
        };
        for p in TRIANGLE {
            for v in p.into_iter().chain([0.0, 0.0, 1.0]) {
                word(&mut out, v.to_le_bytes());
            }
            out.extend([9, 99, 199]);
        }
        for face in faces {
            out.push(face.len() as u8);
            face.iter().for_each(|i| word(&mut out, i.to_le_bytes()));
        }
        out
    };
    vec![
        text.into_bytes(),
        binary("binary_little_endian", false),
        binary("binary_big_endian", true),
    ]
}

/// A triangle with normals, a node above it, a camera, a light and a list of places: as text with
/// its buffer inside, and as one binary file.
pub fn gltf() -> Vec<Vec<u8>> {
    let mut buffer: Vec<u8> = TRIANGLE[..3]
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    buffer.extend(
        [[0f32, 0.0, 1.0]; 3]
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes()),
    );
    buffer.extend([0_u16, 1, 2, 0].iter().flat_map(|i| i.to_le_bytes()));
    let text = |uri: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_lights_punctual","KHR_materials_emissive_strength"],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point","intensity":4.0}},{{"type":"spot","spot":{{"innerConeAngle":0.25,"outerConeAngle":0.5}}}}]}}}},
"scene":0,"scenes":[{{"nodes":[0,2,3,4]}}],"nodes":[{{"translation":[0,10,0],"children":[1]}},{{"mesh":0,"scale":[2,2,2]}},
{{"camera":0,"translation":[0,0,5]}},{{"rotation":[-0.5,0,0,0.5],"extensions":{{"KHR_lights_punctual":{{"light":1}}}}}},
{{"mesh":0,"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{"TRANSLATION":0}}}}}}}}],
"cameras":[{{"type":"perspective","perspective":{{"yfov":0.8,"znear":0.1,"aspectRatio":2.0}}}}],
"materials":[{{"emissiveFactor":[0.5,1,0],"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":6.0}}}},"pbrMetallicRoughness":{{"baseColorFactor":[0.1,0.2,0.3,1]}}}}],
"meshes":[{{"primitives":[{{"material":0,"indices":2,"attributes":{{"POSITION":0,"NORMAL":1}}}}]}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
{{"bufferView":0,"byteOffset":36,"componentType":5126,"count":3,"type":"VEC3"}},{{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":72}},{{"buffer":0,"byteOffset":72,"byteLength":8}}],
"buffers":[{{{uri}"byteLength":{}}}]}}"#,
            buffer.len()
        )
    };
    let data = base64::encode(&buffer);
    let inside = text(&format!(
        "\"uri\":\"data:application/octet-stream;base64,{data}\","
    ));
    let mut json = text("").into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        [&(data.len() as u32).to_le_bytes(), &kind[..], data].concat()
    };
    let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &buffer)].concat();
    let mut binary = b"glTF\x02\0\0\0".to_vec();
    binary.extend((chunks.len() as u32 + 12).to_le_bytes());
    binary.extend(chunks);
    vec![inside.into_bytes(), binary]
}

/// A fog volume of one leaf of 8^3 voxels and a tile, with values as they are, without those that
/// are not active, and packed.
pub fn vdb() -> Vec<Vec<u8>> {
    [0_u32, 2, 1, 3].into_iter().map(of_compression).collect()
}

fn of_compression(compression: u32) -> Vec<u8> {
    let text = |s: &str| [&(s.len() as u32).to_le_bytes(), s.as_bytes()].concat();
    let mask = |bits: usize, is_on: &dyn Fn(usize) -> bool| -> Vec<u8> {
        let byte = |b: usize| (0..8).fold(0, |v, bit| v | u8::from(is_on(8 * b + bit)) << bit);
        (0..bits / 8).map(byte).collect()
    };
    let values = |values: &[f32], is_on: &dyn Fn(usize) -> bool| -> Vec<u8> {
        let kept = (0..values.len()).filter(|i| compression & 2 == 0 || is_on(*i));
        let data: Vec<u8> = kept.flat_map(|i| values[i].to_le_bytes()).collect();
        let kind = if compression & 2 != 0 { 0 } else { 6 };
        if compression & 1 == 0 {
            return [&[kind], &data[..]].concat();
        }
        let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
        zip.write_all(&data).unwrap();
        let packed = zip.finish().unwrap();
        let (len, data) = match packed.len() < data.len() {
            true => (packed.len() as i64, packed),
            false => (-(data.len() as i64), data),
        };
        [&[kind], &len.to_le_bytes()[..], &data].concat()
    };
    let node = |size: usize, child: usize, tile: usize| {
        let mut all = vec![0.0; size];
        all[tile] = 0.5;
        let parts = [
            mask(size, &|i| i == child),
            mask(size, &|i| i == tile),
            values(&all, &|i| i == tile),
        ];
        parts.concat()
    };
    let is_on = |i: usize| !i.is_multiple_of(3);
    let voxels: Vec<f32> = (0..512)
        .map(|i| if is_on(i) { 0.25 * (i % 7) as f32 } else { 0.0 })
        .collect();
    let mut tree = 1_u32.to_le_bytes().to_vec();
    tree.extend([0; 8]);
    tree.extend(1_u32.to_le_bytes());
    tree.extend([0; 12]);
    tree.extend(node(32768, 0, 40_000 % 32768));
    tree.extend(node(4096, 0, 17));
    tree.extend(mask(512, &is_on));
    tree.extend(mask(512, &is_on));
    tree.extend(values(&voxels, &is_on));
    let mut grid = compression.to_le_bytes().to_vec();
    grid.extend(1_u32.to_le_bytes());
    grid.extend([text("class"), text("string"), text("fog volume")].concat());
    grid.extend(text("UniformScaleMap"));
    grid.extend([0.5f64; 15].iter().flat_map(|v| v.to_le_bytes()));
    grid.extend(tree);
    let mut out = 0x5644_4220_u64.to_le_bytes().to_vec();
    out.extend(224_u32.to_le_bytes());
    out.extend([10, 0, 0, 0, 1, 0, 0, 0, 1]);
    out.extend([b'x'; 36]);
    out.extend(0_u32.to_le_bytes());
    out.extend(1_u32.to_le_bytes());
    out.extend([text("density"), text("Tree_float_5_4_3"), text("")].concat());
    let at = out.len() + 24;
    for offset in [at, at, at + grid.len()] {
        out.extend((offset as i64).to_le_bytes());
    }
    out.extend(grid);
    out
}

/// A scene of Mitsuba beside the files that it names.
pub const MITSUBA: &str = r#"<?xml version="1.0"?>
<scene version="3.0.0">
<default name="size" value="2"/>
<sensor type="perspective" id="a"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film></sensor>
<bsdf type="twosided" id="b"><bsdf type="diffuse"><texture name="reflectance" type="bitmap">
<string name="filename" value="a.png"/></texture></bsdf></bsdf>
<shape type="obj"><string name="filename" value="a.obj"/><ref id="b"/>
<transform name="to_world"><scale value="$size"/><rotate y="1" angle="30"/>
<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
<shape type="shapegroup" id="g"><shape type="cube"/></shape>
<shape type="instance"><ref id="g"/><transform name="to_world"><translate x="3"/></transform></shape>
<shape type="disk"><emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter></shape>
<emitter type="spot"><spectrum name="intensity" value="3"/><float name="cutoff_angle" value="30"/></emitter>
<shape type="cube"><bsdf type="null"/><medium type="heterogeneous" name="interior">
<volume type="gridvolume" name="sigma_t"><string name="filename" value="a.vol"/></volume>
<rgb name="albedo" value="0.9"/><phase type="hg"><float name="g" value="0.3"/></phase></medium></shape>
</scene>
"#;

/// Volumes of Mitsuba, of one channel and of three.
pub fn vol() -> Vec<Vec<u8>> {
    let of = |channels: i32| {
        let mut file = b"VOL\x03\x01\0\0\0".to_vec();
        file.extend([4, 3, 2, channels].into_iter().flat_map(i32::to_le_bytes));
        let corners = [0.0_f32, 0.0, 0.0, 1.0, 1.0, 1.0];
        let values = (0..24 * channels).map(|i| i as f32 * 0.25);
        file.extend(corners.into_iter().chain(values).flat_map(f32::to_le_bytes));
        file
    };
    vec![of(1), of(3)]
}

pub fn nrrd() -> Vec<Vec<u8>> {
    let header = "NRRD0004\n# by hand\ntype: float\ndimension: 3\nsizes: 4 3 2\n\
space: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,2)\nspace origin: (0,0,0)\n\
kinds: domain domain domain\nendian: little\nencoding: ";
    let values = (0..24).map(|i| i as f32 * 0.25);
    let data: Vec<u8> = values.clone().flat_map(f32::to_le_bytes).collect();
    let text: Vec<String> = values.map(|v| v.to_string()).collect();
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(&data).unwrap();
    let packed = gzip.finish().unwrap();
    let kinds = [
        ("raw", &data[..]),
        ("gzip", &packed),
        ("ascii", text.join(" ").as_bytes()),
    ]
    .map(|(name, data)| [format!("{header}{name}\n\n").as_bytes(), data].concat());
    kinds.into()
}

/// Both versions, with `sform` and with `qform`, plain and packed.
pub fn nifti() -> Vec<Vec<u8>> {
    let data: Vec<u8> = (0..24).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let mut first = vec![0; 352];
    let mut put = |at: usize, bytes: &[u8]| first[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348_i32.to_le_bytes());
    put(40, [3_i16, 4, 3, 2].map(i16::to_le_bytes).as_flattened());
    put(70, [16_i16, 32].map(i16::to_le_bytes).as_flattened());
    put(
        76,
        [1_f32, 1.0, 1.0, 2.0].map(f32::to_le_bytes).as_flattened(),
    );
    put(
        108,
        [352_f32, 0.5, 1.0].map(f32::to_le_bytes).as_flattened(),
    );
    put(252, [1_i16, 0].map(i16::to_le_bytes).as_flattened());
    put(344, b"n+1\0");
    let mut second = vec![0; 544];
    let mut put = |at: usize, bytes: &[u8]| second[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &540_i32.to_le_bytes());
    put(4, b"n+2\0\r\n\x1a\n");
    put(12, [16_i16, 32].map(i16::to_le_bytes).as_flattened());
    put(16, [3_i64, 4, 3, 2].map(i64::to_le_bytes).as_flattened());
    put(168, &544_i64.to_le_bytes());
    put(348, &1_i32.to_le_bytes());
    for row in 0..3 {
        put(400 + 40 * row, &1_f64.to_le_bytes());
    }
    let plain = [first, second].map(|head| [head, data.clone()].concat());
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(&plain[0]).unwrap();
    let mut all = Vec::from(plain);
    all.push(gzip.finish().unwrap());
    all
}

pub fn metaimage() -> Vec<Vec<u8>> {
    let header = "ObjectType = Image\nNDims = 3\nBinaryData = True\n\
TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 1 1 2\nDimSize = 4 3 2\n\
ElementType = MET_FLOAT\n";
    let data: Vec<u8> = (0..24).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::default());
    zlib.write_all(&data).unwrap();
    let packed = zlib.finish().unwrap();
    let last = "ElementDataFile = LOCAL\n";
    [("False", &data), ("True", &packed)]
        .map(|(is_packed, data)| {
            let head = format!("{header}CompressedData = {is_packed}\n{last}");
            [head.as_bytes(), &data[..]].concat()
        })
        .into()
}

fn picture() -> RgbImage {
    RgbImage::from_fn(7, 5, |x, y| {
        image::Rgb([(x * 30) as u8, (y * 50) as u8, 128])
    })
}

/// A picture in each format that textures may have.
pub fn textures() -> Vec<Vec<u8>> {
    use ImageFormat::{Bmp, Gif, Jpeg, Png, Tga, Tiff, WebP};
    let mut files = Vec::new();
    for (format, picture) in [
        (Png, DynamicImage::from(picture())),
        (Png, DynamicImage::from(picture()).into_luma16().into()),
        (Jpeg, picture().into()),
        (Tga, picture().into()),
        (Bmp, picture().into()),
        (Tiff, picture().into()),
        (Gif, picture().into()),
        (WebP, picture().into()),
    ] {
        let mut file = Cursor::new(Vec::new());
        picture.write_to(&mut file, format).unwrap();
        files.push(file.into_inner());
    }
    files
}

/// Puts the checksums of a PNG file right, as far as it still has chunks.
pub fn repair_png(file: &mut [u8]) {
    let mut at = 8;
    while let Some(len) = file.get(at..at + 4) {
        let len = u32::from_be_bytes([len[0], len[1], len[2], len[3]]) as usize;
        let Some(end) = at.checked_add(8 + len).filter(|end| end + 4 <= file.len()) else {
            return;
        };
        let mut crc = flate2::Crc::new();
        crc.update(&file[at + 4..end]);
        file[end..end + 4].copy_from_slice(&crc.sum().to_be_bytes());
        at = end + 4;
    }
}

/// Two halves of a frame, and all of it, of 16-bit and of 32-bit floats.
pub fn tiles() -> Vec<Vec<u8>> {
    let mut files = Vec::new();
    for precision in [exr::Precision::Half, exr::Precision::Float] {
        for (x0, x1) in [(0, 5), (5, 9), (0, 9)] {
            let region = Region {
                x0,
                y0: 0,
                x1,
                y1: 20,
            };
            let mut frame = Frame::new(9, 20, region);
            let pixels: Vec<[f32; 3]> =
                (0..region.pixels()).map(|i| [i as f32, 0.5, 1e3]).collect();
            frame.layers.push(Layer::rgb("", &pixels));
            frame
                .layers
                .push(Layer::single("depth", "Z", vec![2.0; pixels.len()]));
            frame.attributes.insert("lvox/scene".into(), "5ce".into());
            files.push(exr::encode(&frame, precision).unwrap());
        }
    }
    files
}

/// A scene of all kinds of things, most of which need no file.
pub const SCENE: &str = r#"name = "room"
[film]
width = 16
height = 12
exposure = 1.5
[[camera]]
name = "front"
position = [0, 1, 3.9]
target = [0, 1, 0]
fov_x_deg = 40
[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [90, 0, 0]
translate = [0, 1, -1]
albedo = [0.7, 0.7, 0.7]
[[mesh]]
file = "a.obj"
scale = [0.5, 0.8, 0.5]
emission = [10, 9, 7]
[[light]]
type = "spot"
position = [0, 2, 0]
direction = [0, -1, 0]
intensity = [1, 1, 1]
inner_deg = 10
outer_deg = 20
[[light]]
type = "directional"
direction = [3, -4, 0]
irradiance = [1, 1, 1]
[[volume]]
file = "smoke.raw"
dims = [4, 4, 4]
dtype = "u8"
sigma_t_scale = 6
value_scale = 0.00392156862745098
albedo = [0.8, 0.8, 0.8]
unitcube_to_world = [[0.9, 0, 0, -0.9], [0, 0.9, 0, 0.3], [0, 0, 0.9, -0.2], [0, 0, 0, 1]]
"#;
