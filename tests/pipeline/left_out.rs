//! What a scene does not have takes no byte in its files.

use crate::{ROOM, Work};
use lvox::inspect::{self, Description};
use lvox::internals::tree::media;
use lvox::tree::OpenTree;
use std::fs;
use std::path::Path;

/// The room without its light's colour and its smoke.
fn room(emission: &str, more: &str) -> String {
    let (surfaces, _) = ROOM.split_once("[[volume]]").unwrap();
    surfaces.replace("[10, 9, 7]", emission) + more
}

const SMOKE: &str = include_str!("left_out/smoke.toml");
const LIGHTS: &str = include_str!("left_out/lights.toml");

/// Cloud and tree of a scene, in `work`.
fn files(work: &Work) -> [Description; 2] {
    let tree = work.bake(&work.scene(), 5000);
    [work.path("scene.lvc"), tree].map(|path| inspect::describe(&path).unwrap())
}

/// Whether a file holds a text.
fn holds(path: &Path, text: &str) -> bool {
    let bytes = fs::read(path).unwrap();
    bytes.windows(text.len()).any(|w| w == text.as_bytes())
}

#[test]
fn surfaces_alone_have_no_byte_for_media() {
    let work = Work::new(&room("[10, 9, 7]", ""));
    let names = ["scene.lvc", "scene.lvt"].map(|name| work.path(name));
    for (file, path) in files(&work).iter().zip(&names) {
        assert_eq!((file.lvoxels.count, file.lvoxels.stored_bytes), (0, 0));
        assert_eq!((file.lvoxels.blocks, file.volumes.len()), (0, 0));
        // Not even the name of a column or the sums of a volume.
        assert!(!holds(path, "sigma_t") && !holds(path, "source"));
        assert!(file.sums.volumes.is_empty());
    }
    let store = OpenTree::open(&names[1], None).unwrap();
    assert!(media(&store).is_empty());
    assert_eq!(media(&store).bytes(), 0);

    let smoky = Work::new(&room("[10, 9, 7]", SMOKE));
    for file in files(&smoky) {
        assert!(file.lvoxels.count > 1000 && file.lvoxels.stored_bytes > 1000);
        assert!(holds(Path::new(&file.file), "sigma_t"));
    }
}

/// What a file says that it has none of, and why.
fn absent(file: &Description) -> Vec<(&str, &str)> {
    let left_out = file.left_out.iter();
    left_out
        .filter(|c| c.raw_bytes == 0)
        .map(|c| (c.name.as_str(), c.because.as_str()))
        .collect()
}

#[test]
fn kinds_of_points_that_a_file_has_none_of_are_listed() {
    let bare = Work::new(&room("[10, 9, 7]", ""));
    for file in &files(&bare) {
        assert_eq!(absent(file), [("lvoxels", "no volume in the scene")]);
        let text = file.to_string();
        let line = text.lines().find(|l| l.ends_with("no volume in the scene"));
        let words: Vec<_> = line.unwrap().split_whitespace().take(2).collect();
        assert_eq!(words, ["lvoxels", "all"]);
        let json = serde_json::to_value(file).unwrap();
        let entry = json["left_out"].as_array().unwrap().last().unwrap();
        assert_eq!(
            (&entry["name"], &entry["raw_bytes"]),
            (&"lvoxels".into(), &0.into())
        );
    }
    for file in &files(&Work::new(&room("[10, 9, 7]", SMOKE))) {
        assert_eq!(absent(file), []);
    }

    let (film, _) = ROOM.split_once("[[mesh]]").unwrap();
    let smoke = Work::new(&format!("{film}{SMOKE}\n{LIGHTS}"));
    let because = "no surface was baked";
    let [cloud, tree] = files(&smoke);
    assert_eq!(absent(&cloud), [("surfels", because)]);
    assert_eq!(absent(&tree), [("surfels", because), ("nodes", because)]);
}

#[test]
fn grey_media_take_few_of_the_bytes_of_coloured_ones() {
    let grey = Work::new(&room("[9, 9, 9]", SMOKE));
    let warm = Work::new(&room("[10, 9, 7]", SMOKE));
    let coloured = Work::new(&room("[10, 9, 7]", &format!("{SMOKE}\n{LIGHTS}")));
    let [grey_files, warm_files, coloured_files] = [&grey, &warm, &coloured].map(files);
    // Of a cloud and of a tree, whose extinction takes a larger share.
    let most_shares = [0.6, 0.65];
    let pairs = grey_files.iter().zip(&warm_files).zip(most_shares);
    let more = grey_files.iter().zip(&coloured_files).zip(most_shares);
    for ((grey, coloured), most_share) in pairs.chain(more) {
        assert_eq!(grey.lvoxels.count, coloured.lvoxels.count);
        let has = |file: &Description, name: &str| file.columns.iter().any(|c| c.name == name);
        let is_grey = |file| has(file, "source_grey");
        assert!(is_grey(grey) && !has(grey, "source"));
        assert!(has(coloured, "source") && !is_grey(coloured));
        let share = grey.lvoxels.bytes_each / coloured.lvoxels.bytes_each;
        assert!(share <= most_share, "{}: {share}", grey.kind);
    }
}
