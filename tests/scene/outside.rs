//! Files that meshes, materials and volumes name: who made them does not choose which files of the
//! machine are read.

use crate::support::program::lvox;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::scene::load::Settings;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
const MTL: &str = "newmtl m\nKd 0.1 0.2 0.3\n";

/// A folder of files in folders, among them the scene `in/scene.toml`.
struct Tree(TempDir);

impl Tree {
    fn new(files: &[(&str, &[u8])]) -> Self {
        let tree = Self(tempfile::tempdir().unwrap());
        for (name, content) in files {
            let path = tree.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        tree
    }

    /// A scene of one mesh.
    fn of_mesh(mesh: &str, files: &[(&str, &[u8])]) -> Self {
        let scene = format!("[[mesh]]\nfile = {mesh:?}\n");
        Self::new(&[files, &[("in/scene.toml", scene.as_bytes())]].concat())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn load(&self, allow_outside: bool) -> lvox::Result<Scene> {
        let settings = Settings {
            allow_outside,
            ..Settings::default()
        };
        let scene = self.path().join("in/scene.toml");
        Scene::load_with(&scene, &settings, &Job::default())
    }

    /// The albedo of the one material, whether it has a texture, and what is told of files outside.
    fn look(&self, allow_outside: bool) -> ([f32; 3], bool, Vec<String>) {
        let mut scene = self.load(allow_outside).unwrap();
        assert_eq!(scene.materials.len(), 1);
        scene.warnings.retain(|w| w.contains("the folders of"));
        let material = &scene.materials[0];
        (material.albedo, material.texture.is_some(), scene.warnings)
    }
}

fn png() -> Vec<u8> {
    let mut png = std::io::Cursor::new(Vec::new());
    let image = image::GrayImage::from_pixel(2, 2, image::Luma([200]));
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    png.into_inner()
}

#[test]
fn materials_outside_are_left_out_unless_they_are_allowed() {
    let obj = format!("mtllib ../m.mtl\n{OBJ}");
    let files = [("in/a.obj", obj.as_bytes()), ("m.mtl", MTL.as_bytes())];
    let tree = Tree::of_mesh("a.obj", &files);
    let (grey, _, warnings) = tree.look(false);
    assert_eq!(grey, [0.5; 3]);
    let [warning] = &warnings[..] else {
        panic!("{warnings:?}")
    };
    assert!(warning.contains("m.mtl lies outside"), "{warning}");
    assert!(warning.ends_with("its materials are grey"), "{warning}");
    assert_eq!(tree.look(true), ([0.1, 0.2, 0.3], false, vec![]));

    let told = lvox(tree.path(), &["inspect", "in/scene.toml"]);
    assert!(told.stdout.contains("--allow-outside"), "{}", told.stdout);
    let bake = ["bake", "in/scene.toml", "-o", "a.lvc", "--strict"];
    lvox(tree.path(), &bake).refused(2, &["--allow-outside would allow"]);
    let allowed = ["inspect", "in/scene.toml", "--allow-outside"];
    let told = lvox(tree.path(), &allowed).stdout;
    assert!(told.contains("0.1 0.2 0.3"), "{told}");
}

#[test]
fn textures_outside_are_left_out_unless_they_are_allowed() {
    let png = png();
    let obj = format!("mtllib m.mtl\n{OBJ}");
    let secret = Tree::new(&[("secret.png", &png)]);
    let absolute = secret.path().join("secret.png");
    for name in ["../t.png", absolute.to_str().unwrap(), "link.png"] {
        let mtl = format!("{MTL}map_Kd {name}\n");
        let files = [
            ("in/a.obj", obj.as_bytes()),
            ("in/m.mtl", mtl.as_bytes()),
            ("t.png", &png),
        ];
        let tree = Tree::of_mesh("a.obj", &files);
        if name == "link.png" {
            #[cfg(unix)]
            std::os::unix::fs::symlink(&absolute, tree.path().join("in/link.png")).unwrap();
            #[cfg(not(unix))]
            continue;
        }
        let (_, has_texture, warnings) = tree.look(false);
        assert!(!has_texture && warnings.len() == 1, "{name}: {warnings:?}");
        assert!(warnings[0].contains("textures that cannot be read are left out"));
        assert!(tree.look(true).1, "{name}");
        // A file of that name beside the materials is what is meant.
        if name != "link.png" {
            let last = Path::new(name).file_name().unwrap();
            fs::write(tree.path().join("in").join(last), &png).unwrap();
            let (_, has_texture, warnings) = tree.look(false);
            assert!(has_texture && warnings.is_empty(), "{name}: {warnings:?}");
        }
    }
}

/// As assets are often laid out; and the scene itself may name what is anywhere.
#[test]
fn folders_of_the_scene_and_of_its_meshes_are_inside() {
    let png = png();
    let obj = format!("mtllib ../materials/m.mtl\n{OBJ}");
    let mtl = format!("{MTL}map_Kd ..\\textures\\t.png\n");
    let files = [
        ("in/models/a.obj", obj.as_bytes()),
        ("in/materials/m.mtl", mtl.as_bytes()),
        ("in/textures/t.png", &png),
    ];
    let expected = ([0.1, 0.2, 0.3], true, vec![]);
    assert_eq!(Tree::of_mesh("models/a.obj", &files).look(false), expected);

    let obj = format!("mtllib parts/m.mtl\n{OBJ}");
    let mtl = format!("{MTL}map_Kd ../t.png\n");
    let files = [
        ("other/a.obj", obj.as_bytes()),
        ("other/parts/m.mtl", mtl.as_bytes()),
        ("other/t.png", &png[..]),
        ("t.png", &png),
    ];
    let tree = Tree::of_mesh("../other/a.obj", &files);
    assert_eq!(tree.look(false), expected);
    let scene = "[[mesh]]\nfile = \"../other/a.obj\"\ntexture = \"../t.png\"\n";
    fs::write(tree.path().join("in/scene.toml"), scene).unwrap();
    assert_eq!(tree.look(false), ([1.0; 3], true, vec![]));
}

#[test]
fn buffers_and_samples_outside_are_refused_and_not_quoted() {
    let gltf = |uri: &str| {
        serde_json::json!({
            "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"componentType": 5126, "type": "VEC3", "count": 3, "bufferView": 0}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": uri}]
        })
        .to_string()
    };
    let corners = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].map(f32::to_le_bytes);
    let inside = gltf("b.bin");
    let buffer = corners.as_flattened();
    let files = [("in/a.gltf", inside.as_bytes()), ("in/b.bin", buffer)];
    Tree::of_mesh("a.gltf", &files).load(false).unwrap();
    let outside = gltf("../b.bin");
    let files = [("in/a.gltf", outside.as_bytes()), ("b.bin", buffer)];
    let tree = Tree::of_mesh("a.gltf", &files);
    tree.load(true).unwrap();
    let error = tree.load(false).unwrap_err();
    assert_eq!(error.kind(), lvox::Kind::Input);
    let message = error.to_string();
    assert!(message.contains("buffer 0: buffer file"), "{message}");
    assert!(
        message.ends_with("which `allow_outside` would allow"),
        "{message}"
    );
    lvox(tree.path(), &["inspect", "in/a.gltf"]).refused(2, &["--allow-outside"]);

    // Words of a file that is none of samples are in no message, allowed or not.
    let nrrd = "NRRD0004\ntype: float\ndimension: 3\nsizes: 1 1 1\nencoding: ascii\n\
                spacings: 1 1 1\ndata file: ../secret.txt\n";
    let scene = "[[volume]]\nfile = \"a.nhdr\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    let tree = Tree::new(&[
        ("in/scene.toml", scene.as_bytes()),
        ("in/a.nhdr", nrrd.as_bytes()),
        ("secret.txt", b"password"),
    ]);
    for (allow_outside, part) in [(false, "`allow_outside`"), (true, "expected a number")] {
        let message = tree.load(allow_outside).unwrap_err().to_string();
        assert!(
            message.contains(part) && !message.contains("password"),
            "{message}"
        );
    }
}
