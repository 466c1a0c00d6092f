//! A verb for each of some frames: the command line of a frame, with its number in place of tokens.

use super::files::Files;
use crate::run::{Frames, frames};
use crate::{Error, Result};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The words of the command line in a frame.
pub fn words(words: impl Iterator<Item = OsString>, frame: i32) -> Vec<OsString> {
    let at_frame = |word: OsString| match word.to_str() {
        Some(text) => frames::at_frame(text, frame).into_owned().into(),
        None => at_frame_around_foreign_bytes(word, frame),
    };
    words.map(at_frame).collect()
}

/// A word in a frame whose other bytes, as in names of folders in Latin-1, stay as they are.
#[cfg(unix)]
fn at_frame_around_foreign_bytes(word: OsString, frame: i32) -> OsString {
    use std::os::unix::ffi::OsStringExt;
    let mut bytes = Vec::with_capacity(word.len() + 8);
    for chunk in word.into_vec().utf8_chunks() {
        bytes.extend_from_slice(frames::at_frame(chunk.valid(), frame).as_bytes());
        bytes.extend_from_slice(chunk.invalid());
    }
    OsString::from_vec(bytes)
}

/// Elsewhere the text of such a word cannot be taken apart.
#[cfg(not(unix))]
fn at_frame_around_foreign_bytes(word: OsString, _: i32) -> OsString {
    word
}

/// Refuses tokens where there are no frames whose number could take their place.
///
/// # Errors
/// The first token, and the word that it is in.
pub fn refuse_tokens(words: impl Iterator<Item = OsString>) -> Result<()> {
    for word in words {
        let word = word.to_string_lossy();
        if let Some(token) = frames::token_in(&word) {
            return Err(Error::input(format!(
                "found {token} in {word}, which stands for the number of a frame, but no frames"
            ))
            .hint("give `frames`, as 1-10"));
        }
    }
    Ok(())
}

/// Refuses several frames that would write the same file.
///
/// # Errors
/// The output without a token.
pub fn check_outputs(files: &Files, frames: &Frames) -> Result<()> {
    let [first, second, ..] = frames.numbers() else {
        return Ok(());
    };
    let has_token = |path: &Path| frames::token_in(&path.to_string_lossy()).is_some();
    // All frames may share a tree.
    let is_shared = |what: &str| what == "--keep-tree";
    let is_one = |(what, path): &&(&str, PathBuf)| !has_token(path) && !is_shared(what);
    match files.outputs.iter().find(is_one) {
        None => Ok(()),
        Some((what, path)) => Err(Error::input(format!(
            "{what} {}: frames {first} and {second} would write the same file",
            path.display()
        ))
        .hint("put #### for the number of the frame into its name, as out.####.exr")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(words: &[&str]) -> impl Iterator<Item = OsString> {
        let owned: Vec<OsString> = words.iter().map(OsString::from).collect();
        owned.into_iter()
    }

    #[test]
    fn words_have_the_number() {
        let found = words(all(&["lvox", "shade", "-o", "x.####.exr", "a#b"]), 12);
        assert_eq!(found, ["lvox", "shade", "-o", "x.0012.exr", "a#b"]);
    }

    #[cfg(unix)]
    #[test]
    fn words_that_are_not_utf8_have_the_number() {
        use std::os::unix::ffi::OsStringExt;
        let word = |bytes: &[u8]| OsString::from_vec(bytes.to_vec());
        let name = word(b"Gr\xf6\xdfe/x.####.\xf6.%02d.exr");
        let found = words([name.clone()].into_iter(), 7);
        assert_eq!(found, [word(b"Gr\xf6\xdfe/x.0007.\xf6.07.exr")]);
        let error = refuse_tokens([name].into_iter()).unwrap_err();
        assert!(error.to_string().contains("#### in Gr"), "{error}");
    }

    #[test]
    fn tokens_need_frames() {
        refuse_tokens(all(&["lvox", "100%.exr"])).unwrap();
        let error = refuse_tokens(all(&["lvox", "x.%03d.exr"])).unwrap_err();
        assert!(error.to_string().contains("%03d in x.%03d.exr"), "{error}");
    }

    #[test]
    fn frames_write_files_of_their_own() {
        let files = |path: &str| Files::default().writes("--output", Path::new(path));
        let frames = |text: &str| text.parse::<Frames>().unwrap();
        check_outputs(&files("x.exr"), &frames("7")).unwrap();
        check_outputs(&files("x.$F.exr"), &frames("7-9")).unwrap();
        let error = check_outputs(&files("x.exr"), &frames("7-9")).unwrap_err();
        assert!(error.to_string().contains("frames 7 and 8"), "{error}");
    }
}
