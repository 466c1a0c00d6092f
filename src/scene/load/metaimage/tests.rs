//! Small MetaImage files written here.

use super::*;
use std::io::Write;

const VALUES: [f32; 4] = [7.0, 0.0, 255.0, 16.0];
const BYTES: [u8; 4] = [7, 0, 255, 16];

/// What stands in a header, changed so that the lines `more` are there in the place of others of
/// the name.
fn header(more: &str, data: &str) -> String {
    let mut text = String::new();
    let name = |line: &str| line.split('=').next().map(|n| n.trim().to_owned());
    let plain = "ObjectType = Image\nNDims = 3\nBinaryData = True\nDimSize = 2 1 2\n\
                 ElementType = MET_UCHAR";
    for line in plain.lines() {
        if !more.lines().any(|m| name(m) == name(line)) {
            text += &format!("{line}\n");
        }
    }
    format!("{text}{more}\nElementDataFile = {data}\n")
}

fn field(header: &str, data: &[u8]) -> Result<(Field, Vec<String>)> {
    let mut files = Files::default();
    let content = [header.as_bytes(), data].concat();
    let field = read(content, Path::new("x.mha"), &mut files)?;
    Ok((field, files.warnings))
}

fn values(field: &Field) -> Vec<f32> {
    let [nx, ny, nz] = field.dims;
    let voxels = (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / nx / ny]);
    voxels.map(|v| field.value(v)).collect()
}

fn load(more: &str, data: &[u8]) -> Result<(Vec<f32>, Vec<String>)> {
    field(&header(more, "LOCAL"), data).map(|(field, warnings)| (values(&field), warnings))
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

#[test]
fn raw_packed_and_written_samples_are_the_same() {
    for (more, data) in [
        ("", BYTES.to_vec()),
        ("HeaderSize = 3", [&[1, 2, 3][..], &BYTES].concat()),
        ("HeaderSize = -1", [&[1, 2, 3][..], &BYTES].concat()),
        (
            "CompressedData = True\nCompressedDataSize = 12",
            zlib(&BYTES),
        ),
        ("BinaryData = False", b"7 0\n255, 16\n".to_vec()),
    ] {
        let (values, warnings) = load(more, &data).unwrap();
        assert_eq!(values, VALUES, "{more}");
        assert_eq!(warnings, [] as [String; 0]);
        assert!(load(more, &data[..3]).is_err(), "{more}");
    }
    let (_, warnings) = load("", &[&BYTES[..], &[1]].concat()).unwrap();
    assert_eq!(
        warnings,
        ["x.mha: there is more data than `DimSize` says; the rest is left out"]
    );
}

#[test]
fn every_type_and_byte_order_is_read() {
    for (name, bytes) in [
        ("MET_SHORT", 300_i16.to_le_bytes().to_vec()),
        ("MET_USHORT", 300_u16.to_le_bytes().to_vec()),
        ("MET_INT", 300_i32.to_le_bytes().to_vec()),
        ("MET_LONG", 300_i32.to_le_bytes().to_vec()),
        ("MET_UINT", 300_u32.to_le_bytes().to_vec()),
        ("MET_LONG_LONG", 300_i64.to_le_bytes().to_vec()),
        ("MET_ULONG_LONG", 300_u64.to_le_bytes().to_vec()),
        ("MET_FLOAT", 300_f32.to_le_bytes().to_vec()),
        ("MET_DOUBLE", 300_f64.to_le_bytes().to_vec()),
    ] {
        for big_endian in [false, true] {
            let mut sample = bytes.clone();
            if big_endian {
                sample.reverse();
            }
            let more = format!("ElementType = {name}\nElementByteOrderMSB = {big_endian}");
            let more = match big_endian {
                true => more.replace("true", "True"),
                false => more,
            };
            assert_eq!(
                load(&more, &sample.repeat(4)).unwrap().0,
                [300.0; 4],
                "{more}"
            );
        }
    }
    assert_eq!(load("ElementType = MET_CHAR", &BYTES).unwrap().0[2], -1.0);
}

#[test]
fn slices_in_files_of_their_own_are_joined() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a08.raw"), &BYTES[..2]).unwrap();
    std::fs::write(dir.path().join("a10.raw"), &BYTES[2..]).unwrap();
    std::fs::write(dir.path().join("all.zraw"), zlib(&BYTES)).unwrap();
    let path = dir.path().join("x.mhd");
    for (more, names) in [
        ("", "LIST\na08.raw\na10.raw"),
        ("", "a%02d.raw 8 10 2"),
        ("CompressedData = True", "all.zraw"),
    ] {
        let content = header(more, names).into_bytes();
        let field = read(content, &path, &mut Files::default()).unwrap();
        assert_eq!(values(&field), VALUES, "{names}");
    }
    for (names, says) in [
        ("LIST", "expected names of files"),
        ("a%02d.raw", "expected a name such as a%03d.raw"),
        ("no.raw", "is not there"),
        ("", "found nothing"),
    ] {
        let content = header("", names).into_bytes();
        let Err(error) = read(content, &path, &mut Files::default()) else {
            panic!("{names}");
        };
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn axes_are_the_rows_of_the_matrix_and_offset_is_the_first_voxel() {
    // The first axis runs to the back, the second to the left.
    let more = "TransformMatrix = 0 1 0 1 0 0 0 0 -1\nOffset = 10 20 30\nElementSpacing = 2 3 4\n\
                AnatomicalOrientation = RAI";
    let (placed, _) = field(&header(more, "LOCAL"), &BYTES).unwrap();
    let at = |voxel: [f64; 3]| (placed.world_from_file.unwrap()).transform_point3(voxel.into());
    assert_eq!(at([0.0; 3]).to_array(), [10.0, 20.0, 30.0]);
    assert_eq!(at([1.0, 0.0, 0.0]).to_array(), [10.0, 22.0, 30.0]);
    assert_eq!(at([0.0, 1.0, 1.0]).to_array(), [13.0, 20.0, 26.0]);
    assert_eq!(placed.patient, Some(PatientSpace::Lps));
    let unknown = more.replace("RAI", "???");
    let (placed, _) = field(&header(&unknown, "LOCAL"), &BYTES).unwrap();
    assert_eq!(placed.patient, None);
}

#[test]
fn what_is_no_volume_is_refused_in_a_line() {
    for (more, says) in [
        (
            "NDims = 2",
            "expected `NDims = 3` and one channel, found 2 and 1",
        ),
        ("ElementNumberOfChannels = 3", "found 3 and 3"),
        ("DimSize = 2 0 2", "found `DimSize = 2 0 2`"),
        ("DimSize = 99999999 99999999 99999999", "machine can hold"),
        ("DimSize = 9999 9999 9999", "bytes of samples, found 4"),
        (
            "ElementType = MET_STRING",
            "`ElementType = MET_STRING` is not supported",
        ),
        ("Offset = 1 2", "expected 3 numbers, found `Offset = 1 2`"),
        ("Offset = 1 2 nan", "expected 3 numbers"),
        ("TransformMatrix = 1 0 0 1 0 0 0 0 1", "singular"),
        (
            "HeaderSize = x",
            "expected a number, found `HeaderSize = x`",
        ),
        (
            "DimSize = 9999 9999 9999\nCompressedData = True",
            "compressed bytes can hold",
        ),
        (
            "x",
            "line 6: expected `Name = value` up to `ElementDataFile`, found \"x\"",
        ),
    ] {
        let message = load(more, &BYTES).unwrap_err().to_string();
        assert!(
            message.contains(says) && !message.contains('\n'),
            "{message}"
        );
    }
    let message =
        |content: &[u8]| match read(content.to_vec(), Path::new("x"), &mut Files::default()) {
            Ok(_) => panic!("it was read"),
            Err(error) => error.to_string(),
        };
    assert!(message(b"\x89PNG\n").contains("another kind of file"));
    assert!(message(b"NDims = 3\n").contains("found none"));
}
