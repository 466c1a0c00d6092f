//! What the script of a page reads: one JSON object, and blocks of bytes in base64.

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::{Map, Value};
use std::io::Write;

/// Data of a page.
#[derive(Debug, Default)]
pub struct Data {
    values: Map<String, Value>,
    blocks: Vec<String>,
}

impl Data {
    /// Sets a value of the object.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) {
        self.values.insert(name.into(), value.into());
    }

    /// Adds a block as it is; returns its number.
    pub fn add(&mut self, bytes: &[u8]) -> usize {
        self.blocks.push(base64::encode(bytes));
        self.blocks.len() - 1
    }

    /// Adds a block in the format of zlib.
    pub fn add_deflated(&mut self, bytes: &[u8]) -> usize {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        // Writing to memory does not fail.
        let done = encoder.write_all(bytes).and_then(|()| encoder.finish());
        self.add(&done.unwrap_or_default())
    }

    /// The elements that hold it.
    pub fn to_html(&self) -> String {
        // Inside a script nothing is escaped, but no end of it and no comment may stand there.
        let json = Value::from(self.values.clone()).to_string();
        let json = json.replace('<', "\\u003c");
        let mut html = format!("<script type=\"application/json\" id=\"data\">{json}</script>\n");
        for (i, block) in self.blocks.iter().enumerate() {
            html += &format!("<script type=\"text/plain\" id=\"block{i}\">{block}</script>\n");
        }
        html
    }
}
