//! Files with bytes cut off or changed: an error or a scene, never a panic, a hang, or all the
//! memory.

use crate::Folder;
use crate::volumes::{self, Place};
use flate2::{
    Compression,
    write::{GzEncoder, ZlibEncoder},
};
use lvox::Kind;
use std::fs;
use std::io::Write;

/// Loads `text` with every start of the file and with every byte changed in turn.
fn damage(name: &str, content: &[u8], text: &str) {
    let folder = Folder::new(&[(name, content)]);
    folder.load(text).expect("the whole file loads");
    let attempt = |damaged: &[u8]| {
        fs::write(folder.path(name), damaged).unwrap();
        if let Err(error) = folder.load(text) {
            assert_eq!(error.kind(), Kind::Input, "{error}");
        }
    };
    for cut in 0..content.len() {
        attempt(&content[..cut]);
    }
    for at in 0..content.len() {
        for flip in [1, 0x10, 0x80, 0xff] {
            let mut damaged = content.to_vec();
            damaged[at] ^= flip;
            attempt(&damaged);
        }
    }
}

const TRIANGLE: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

#[test]
fn ply() {
    let mut binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n\
property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    let mut ascii = String::from_utf8(binary.clone())
        .unwrap()
        .replace("binary_little_endian", "ascii");
    for p in TRIANGLE {
        binary.extend(p.iter().flat_map(|x| x.to_le_bytes()));
        binary.extend([9, 99, 199]);
        ascii += &format!("{} {} {} 9 99 199\n", p[0], p[1], p[2]);
    }
    binary.push(3);
    binary.extend([0_i32, 1, 2].iter().flat_map(|i| i.to_le_bytes()));
    ascii += "3 0 1 2\n";
    let text = "[[mesh]]\nfile = \"a.ply\"\n";
    damage("a.ply", &binary, text);
    damage("a.ply", ascii.as_bytes(), text);
}

#[test]
fn obj() {
    let obj = b"v 0 0 0\nv 1 0 0 \\\n 1\nv 0 1 0 .1 .2 .3\nvt 0 1\nvn 0 0 1\nf 1/1/1 -2//1 3\n\
                f 1 2 3 1\n";
    damage("a.obj", obj, "[[mesh]]\nfile = \"a.obj\"\n");
}

#[test]
fn nrrd() {
    let header = "NRRD0004\ntype: float\ndimension: 3\nsizes: 3 2 2\nspacings: 1 1 2\n\
endian: little\nencoding: ";
    let data: Vec<u8> = (0..12).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(&data).unwrap();
    let packed = gzip.finish().unwrap();
    let text = "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    let file =
        |encoding: &str, data: &[u8]| [format!("{header}{encoding}\n\n").as_bytes(), data].concat();
    damage("a.nrrd", &file("raw", &data), text);
    damage("a.nrrd", &file("gzip", &packed), text);
}

#[test]
fn metaimage() {
    let header = "NDims = 3\nDimSize = 3 2 2\nElementType = MET_FLOAT\nElementSpacing = 1 1 2\n\
CompressedData = ";
    let data: Vec<u8> = (0..12).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::default());
    zlib.write_all(&data).unwrap();
    let packed = zlib.finish().unwrap();
    let text = "[[volume]]\nfile = \"a.mha\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    let last = "\nElementDataFile = LOCAL\n";
    let file = |is_packed: &str, data: &[u8]| {
        [format!("{header}{is_packed}{last}").as_bytes(), data].concat()
    };
    damage("a.mha", &file("False", &data), text);
    damage("a.mha", &file("True", &packed), text);
}

/// A NIfTI file of 3 x 2 x 2 voxels.
fn nifti_file() -> Vec<u8> {
    let values: Vec<f32> = (0..12).map(|i| i as f32).collect();
    volumes::nifti([3, 2, 2], &values, Place::turned())
}

#[test]
fn nifti() {
    let file = nifti_file();
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(&file).unwrap();
    let packed = gzip.finish().unwrap();
    let text = "[[volume]]\nfile = \"a.nii\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    damage("a.nii", &file, text);
    damage("a.nii.gz", &packed, &text.replace(".nii", ".nii.gz"));
}

#[test]
fn scene_files() {
    let text = include_str!("../acceptance/scenes/A.toml");
    let folder = Folder::new(&[]);
    for cut in (0..text.len()).filter(|c| text.is_char_boundary(*c)) {
        let _ = folder.load(&text[..cut]);
    }
    for at in 0..text.len() {
        for byte in [b'"', b'[', b'-', b'x', b'\n', b'='] {
            let mut damaged = text.as_bytes().to_vec();
            damaged[at] = byte;
            if let Ok(damaged) = String::from_utf8(damaged) {
                let _ = folder.load(&damaged);
            }
        }
    }
}
