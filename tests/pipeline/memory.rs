//! Files that ask for more memory than there is end a run with an error that says so, and not by an
//! abort.

use crate::Work;
use crate::support::program::{self, Run};
use flate2::{Compression, write::ZlibEncoder};
use std::fs::{self, File};
use std::io::Write;

/// KiB of addresses that a run may have.
const LIMIT: usize = 600_000;

fn limited(work: &Work) -> Run {
    let program = program::command(work.0.path(), &[]);
    let program = program.get_program().to_string_lossy().into_owned();
    let line = "reference scene.toml -o a.exr --spp 1 --resolution 8x8 --threads 1";
    let script = format!("ulimit -v {LIMIT}; exec {program} {line}");
    let mut command = std::process::Command::new("bash");
    command.args(["-c", &script]).current_dir(work.0.path());
    Run::of(&mut command)
}

fn refused(scene: &str, needs: &str, make: impl Fn(&Work)) {
    let work = Work::new(scene);
    make(&work);
    let told = ["needs", "of memory, which the system does not give", "hint"];
    limited(&work).refused(1, &[&[needs], &told[..]].concat());
}

#[test]
fn a_gltf_of_many_vertices() {
    // Nothing but zeros, so that most of the memory is not in the file.
    let count = 30 << 20;
    let json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}],
        "accessors": [{{"componentType": 5126, "type": "VEC3", "count": {count}, "min": [0, 0, 0], "max": [0, 0, 0],
            "sparse": {{"count": 1, "indices": {{"bufferView": 0, "componentType": 5121}}, "values": {{"bufferView": 0}}}}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 12}}],
        "buffers": [{{"byteLength": {count}, "uri": "a.bin"}}]}}"#
    );
    refused("[[mesh]]\nfile = \"a.gltf\"\n", "the mesh", |work| {
        fs::write(work.path("a.gltf"), &json).unwrap();
        let bytes = File::create(work.path("a.bin")).unwrap();
        bytes.set_len(count).unwrap();
    });
}

#[test]
fn an_obj_of_many_triangles() {
    refused("[[mesh]]\nfile = \"a.obj\"\n", "the mesh", |work| {
        let face = format!("f{}\n", " 1".repeat(10 << 20));
        fs::write(work.path("a.obj"), "v 0 0 0\n".to_owned() + &face.repeat(4)).unwrap();
    });
}

#[test]
fn a_ply_of_many_triangles() {
    refused("[[mesh]]\nfile = \"a.ply\"\n", "the mesh", |work| {
        let head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uchar x\n\
                    element face 4\nproperty list uint uchar vertex_indices\nend_header\n";
        let corners = 10_u32 << 20;
        let face = [&corners.to_le_bytes()[..], &vec![0; corners as usize]].concat();
        let file = [head.as_bytes(), &[0], &face.repeat(4)].concat();
        fs::write(work.path("a.ply"), &file).unwrap();
    });
}

#[test]
fn a_vdb_of_many_tiles() {
    let text = |s: &str| [&(s.len() as u32).to_le_bytes(), s.as_bytes()].concat();
    let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
    zip.write_all(&[0; 4 * 32768]).unwrap();
    let zip = zip.finish().unwrap();
    // Of each inner node all 32^3 children are tiles of one value.
    let mut node = [vec![0; 12 + 4096], vec![0xff; 4096], vec![6]].concat();
    node.extend((zip.len() as i64).to_le_bytes());
    node.extend(zip);
    let nodes = 1000;

    let mut file = 0x5644_4220_i64.to_le_bytes().to_vec();
    file.extend(224_u32.to_le_bytes());
    file.extend([10, 0, 0, 0, 1, 0, 0, 0, 1]);
    file.extend([b'x'; 36]);
    file.extend([0; 4]);
    file.extend(1_i32.to_le_bytes());
    file.extend([text("density"), text("Tree_float_5_4_3"), text("")].concat());
    let at = file.len() as i64 + 24;
    for offset in [at, at, at + 1] {
        file.extend(offset.to_le_bytes());
    }
    // Zipped; no metadata.
    file.extend([1_u32, 0].map(u32::to_le_bytes).concat());
    file.extend(text("UniformScaleMap"));
    file.extend([1_f64; 15].map(f64::to_le_bytes).concat());
    // One buffer, the background, tiles of the root, inner nodes.
    file.extend([1_u32, 0, 0, nodes].map(u32::to_le_bytes).concat());
    file.extend(node.repeat(nodes as usize));
    let scene = "[[volume]]\nfile = \"a.vdb\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    refused(scene, "a volume", |work| {
        fs::write(work.path("a.vdb"), &file).unwrap();
    });
}
