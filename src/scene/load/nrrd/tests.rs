//! Small NRRD files written here.

use super::*;
use std::io::Write;

/// The values of a file that begins with these lines, and what is told of it.
fn load(header: &str, data: &[u8]) -> Result<(Vec<f32>, Vec<String>)> {
    let content = [format!("NRRD0005\n{header}\n\n").as_bytes(), data].concat();
    load_from(content, Path::new("x.nrrd"))
}

fn load_from(content: Vec<u8>, path: &Path) -> Result<(Vec<f32>, Vec<String>)> {
    let mut files = Files::default();
    let field = read(content, path, &mut files)?;
    let [nx, ny, nz] = field.dims;
    let voxels = (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / nx / ny]);
    Ok((voxels.map(|v| field.value(v)).collect(), files.warnings))
}

fn header(encoding: &str, more: &str) -> String {
    format!("type: uint8\ndimension: 3\nsizes: 2 1 2\nencoding: {encoding}{more}")
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

fn bzip2(bytes: &[u8]) -> Vec<u8> {
    let mut packed = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

const VALUES: [f32; 4] = [7.0, 0.0, 255.0, 16.0];
const BYTES: [u8; 4] = [7, 0, 255, 16];

#[test]
fn every_encoding_gives_the_same_samples() {
    for (encoding, data) in [
        ("raw", BYTES.to_vec()),
        ("gzip", gzip(&BYTES)),
        ("bzip2", bzip2(&BYTES)),
        ("ascii", b"7 0\n255, 16\n".to_vec()),
        ("hex", b"0700 fF\n10".to_vec()),
    ] {
        let (values, warnings) = load(&header(encoding, ""), &data).unwrap();
        assert_eq!(values, VALUES, "{encoding}");
        assert_eq!(warnings, [] as [String; 0]);
        let short = load(&header(encoding, ""), &data[..1]);
        assert!(short.is_err(), "{encoding}");
    }
}

#[test]
fn bytes_are_skipped_and_what_is_too_long_is_told() {
    let long = [&[1, 2, 3][..], &BYTES].concat();
    for (encoding, data) in [
        ("raw", long.clone()),
        ("gzip", gzip(&long)),
        ("bzip2", bzip2(&long)),
    ] {
        for skip in ["-1", "3"] {
            let header = header(encoding, &format!("\nbyte skip: {skip}"));
            let (values, warnings) = load(&header, &data).unwrap();
            assert_eq!(values, VALUES, "{encoding} {skip}");
            assert_eq!(warnings, [] as [String; 0], "{encoding} {skip}");
        }
        let (values, warnings) = load(&header(encoding, "\nbyte skip: 1"), &data).unwrap();
        assert_eq!(values, [2.0, 3.0, 7.0, 0.0], "{encoding}");
        assert_eq!(
            warnings,
            ["x.nrrd: there is more data than `sizes` says; the rest is left out"]
        );
    }
    let (values, warnings) = load(&header("ascii", "\nline skip: 1"), b"x\n7 0 255 16 1").unwrap();
    assert_eq!((&values[..], warnings.len()), (&VALUES[..], 1));
}

#[test]
fn what_is_no_volume_is_refused_and_an_axis_of_one_is_none() {
    for kinds in ["RGB-color domain domain", "domain domain vector"] {
        let message = load(&header("raw", &format!("\nkinds: {kinds}")), &BYTES);
        let message = message.unwrap_err().to_string();
        assert!(message.contains("only scalar volumes"), "{message}");
    }
    load(&header("raw", "\nkinds: domain space domain"), &BYTES).unwrap();
    let segmentation = "type: uint8\ndimension: 4\nsizes: 1 2 1 2\nencoding: raw\n\
                        kinds: list domain domain domain\nspace origin: (0,0,0)\n\
                        space directions: none (1,0,0) (0,1,0) (0,0,2)";
    assert_eq!(load(segmentation, &BYTES).unwrap().0, VALUES);
    let movie = segmentation.replace("sizes: 1 2", "sizes: 2 2");
    assert!(load(&movie, &[0; 8]).is_err());
}

#[test]
fn slices_in_files_of_their_own_are_joined() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a08.raw"), &BYTES[..2]).unwrap();
    std::fs::write(dir.path().join("a10.raw"), &BYTES[2..]).unwrap();
    let path = dir.path().join("x.nhdr");
    for files in [
        "LIST\na08.raw\na10.raw\n",
        "a%02d.raw 8 10 2\n",
        "a%02d.raw 8 10 2 2\n",
    ] {
        let header = header("raw", &format!("\ndata file: {files}"));
        let content = format!("NRRD0005\n{header}").into_bytes();
        assert_eq!(load_from(content, &path).unwrap().0, VALUES, "{files}");
    }
    for files in [
        "LIST\n",
        "a%02d.raw\n",
        "a%02d.raw 1 0 0\n",
        "a%99d.raw 1 2 1\n",
    ] {
        let header = header("raw", &format!("\ndata file: {files}"));
        let content = format!("NRRD0005\n{header}").into_bytes();
        assert!(load_from(content, &path).is_err(), "{files}");
    }
}

#[test]
fn long_integers_are_read() {
    let bytes = [1_i64 << 40, 3].map(i64::to_le_bytes).concat();
    let header = "type: int64\ndimension: 3\nsizes: 2 1 1\nendian: little\nencoding: raw";
    assert_eq!(load(header, &bytes).unwrap().0, [1.099_511_6e12, 3.0]);
}
