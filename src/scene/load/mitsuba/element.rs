//! Typed access to the elements of a Mitsuba file. What was asked for is remembered, so that the
//! rest can be told.

use super::xml::{Node, Tree};
use crate::scene::builder::is_singular;
use crate::scene::load::transform::about;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::fmt::Display;

/// An element of a file.
#[derive(Clone, Copy)]
pub(super) struct Element<'t> {
    pub(super) tree: &'t Tree,
    pub(super) index: usize,
}

/// An axis this near length 1 is one that was rounded in the file.
const UNIT_LENGTH_ERROR: f64 = 1e-3;

/// Elements that are values, not objects.
const VALUES: [&str; 10] = [
    "float",
    "integer",
    "boolean",
    "string",
    "vector",
    "point",
    "rgb",
    "srgb",
    "spectrum",
    "transform",
];

impl<'t> Element<'t> {
    pub(super) fn node(&self) -> &'t Node {
        &self.tree.nodes[self.index]
    }

    pub(super) fn tag(&self) -> &'t str {
        &self.node().tag
    }

    /// The name of its plugin.
    pub(super) fn kind(&self) -> &'t str {
        self.node().get("type").unwrap_or_default()
    }

    /// Its `id`, if it has one.
    pub(super) fn id(&self) -> Option<&'t str> {
        self.node().get("id")
    }

    /// The key that it is the value of, with underscores as Mitsuba 3 has them.
    pub(super) fn name(&self) -> String {
        let mut name = String::new();
        for c in self.node().get("name").unwrap_or_default().chars() {
            if c.is_ascii_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(c.to_ascii_lowercase());
        }
        name
    }

    pub(super) fn line(&self) -> String {
        self.tree.told(self.node().place)
    }

    pub(super) fn error(&self, message: impl Display) -> Error {
        self.tree.error(self.node().place, message)
    }

    pub(super) fn locate(&self, error: Error) -> Error {
        self.tree.located(self.node().place, error)
    }

    /// Whether it is a number, a colour or the like.
    pub(super) fn is_value(&self) -> bool {
        VALUES.contains(&self.tag()) && (self.tag() != "spectrum" || self.kind().is_empty())
    }

    /// What is in it, references resolved, each with its own key.
    pub(super) fn children(&self) -> Result<Vec<(String, Element<'t>)>> {
        let tree = self.tree;
        let child = |&index: &usize| {
            let own = Element { tree, index };
            if own.tag() != "ref" {
                return Ok((own.name(), own));
            }
            let id = own.node().get("id").unwrap_or_default();
            match tree.ids.get(id) {
                Some(&index) => Ok((own.name(), Element { tree, index })),
                None => {
                    let ids: Vec<&str> = tree.ids.keys().map(String::as_str).collect();
                    let error = own.error(format_args!("there is no element with the id `{id}`"));
                    Err(match super::nearest(id, &ids) {
                        Some(near) => error.hint(format!("did you mean `{near}`?")),
                        None => error,
                    })
                }
            }
        };
        self.node().children.iter().map(child).collect()
    }

    /// The objects in it: all but values.
    pub(super) fn objects(&self) -> Result<Vec<(String, Element<'t>)>> {
        let all = self.children()?.into_iter();
        Ok(all.filter(|(_, child)| !child.is_value()).collect())
    }

    /// The first object in it of this tag.
    pub(super) fn object(&self, tag: &str) -> Result<Option<Element<'t>>> {
        let all = self.objects()?.into_iter().map(|(_, child)| child);
        let found = all.into_iter().find(|child| child.tag() == tag);
        Ok(found.inspect(Element::take))
    }

    /// Marks it as asked for.
    pub(super) fn take(&self) {
        self.node().used.set(true);
    }

    /// What a key has as its value, or an object.
    pub(super) fn get(&self, key: &str) -> Result<Option<Element<'t>>> {
        let found = self.children()?.into_iter().find(|(name, _)| name == key);
        let found = found.map(|(_, child)| child);
        Ok(found.inspect(Element::take))
    }

    /// Keys that make no difference here.
    pub(super) fn ignore(&self, keys: &[&str]) -> Result<()> {
        for key in keys {
            self.get(key)?;
        }
        Ok(())
    }

    fn value(&self) -> Result<&'t str> {
        let value = self.node().get("value").map(str::trim);
        value.ok_or_else(|| self.error(format_args!("<{}> has no `value`", self.tag())))
    }

    fn expected(&self, what: &str) -> Error {
        let value: String = self
            .node()
            .get("value")
            .unwrap_or_default()
            .chars()
            .take(40)
            .collect();
        let name = self.name();
        self.error(format_args!("`{name}`: expected {what}, found \"{value}\""))
    }

    /// A finite number.
    pub(super) fn as_number(&self) -> Result<f64> {
        let number = self.value()?.parse().ok().filter(|n: &f64| n.is_finite());
        number.ok_or_else(|| self.expected("a number"))
    }

    /// The number of a key.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        self.get(key)?.map(|value| value.as_number()).transpose()
    }

    /// The number of a key, from `low` to `high`.
    pub(super) fn number_within(&self, key: &str, low: f64, high: f64) -> Result<Option<f64>> {
        let Some(value) = self.get(key)? else {
            return Ok(None);
        };
        let number = value.as_number()?;
        match (low..=high).contains(&number) {
            true => Ok(Some(number)),
            false => Err(value.expected(&format!("a number from {low} to {high}"))),
        }
    }

    /// The whole number of a key, from `low` to `high`.
    pub(super) fn whole(&self, key: &str, low: i64, high: i64) -> Result<Option<i64>> {
        let Some(value) = self.get(key)? else {
            return Ok(None);
        };
        let number = value.value()?.parse().ok();
        let number = number.filter(|n| (low..=high).contains(n));
        let what = format!("a whole number from {low} to {high}");
        number.map(Some).ok_or_else(|| value.expected(&what))
    }

    /// The truth of a key.
    pub(super) fn flag(&self, key: &str, default: bool) -> Result<bool> {
        let Some(value) = self.get(key)? else {
            return Ok(default);
        };
        match value.value()?.to_ascii_lowercase().as_str() {
            "true" => Ok(true),
            "false" => Ok(false),
            _ => Err(value.expected("true or false")),
        }
    }

    /// The text of a key.
    pub(super) fn text(&self, key: &str) -> Result<Option<&'t str>> {
        self.get(key)?.map(|value| value.value()).transpose()
    }

    /// The text of a key that has to be there.
    pub(super) fn require_text(&self, key: &str) -> Result<&'t str> {
        let text = self.text(key)?;
        text.ok_or_else(|| self.error(format_args!("`{key}` of {} is missing", self.kind())))
    }

    /// The point or vector of a key.
    pub(super) fn vector(&self, key: &str) -> Result<Option<DVec3>> {
        self.get(key)?.map(|value| value.as_vector(0.0)).transpose()
    }

    /// Three numbers, as `x`, `y` and `z` or as a list.
    fn as_vector(&self, default: f64) -> Result<DVec3> {
        let node = self.node();
        if let Some(list) = node.get("value") {
            return self.vector_in(list, true);
        }
        let one = |axis: &str| match node.get(axis) {
            None => Ok(default),
            Some(text) => self.parse(axis, text),
        };
        Ok(DVec3::new(one("x")?, one("y")?, one("z")?))
    }

    fn parse(&self, what: &str, text: &str) -> Result<f64> {
        let number = text.trim().parse().ok().filter(|n: &f64| n.is_finite());
        number.ok_or_else(|| {
            let text: String = text.chars().take(40).collect();
            self.error(format_args!(
                "`{what}`: expected a number, found \"{text}\""
            ))
        })
    }

    /// The numbers of a list.
    pub(super) fn list(&self, what: &str, text: &str) -> Result<Vec<f64>> {
        words(text).map(|word| self.parse(what, word)).collect()
    }

    fn vector_in(&self, text: &str, may_be_one: bool) -> Result<DVec3> {
        match self.list("value", text)?[..] {
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            [x] if may_be_one => Ok(DVec3::splat(x)),
            _ => Err(self.error(format_args!(
                "<{}>: expected three numbers, found \"{text}\"",
                self.tag()
            ))),
        }
    }

    /// The map of a key; the identity if it is not there.
    pub(super) fn transform(&self, key: &str) -> Result<DAffine3> {
        match self.get(key)? {
            Some(value) => value.as_transform(),
            None => Ok(DAffine3::IDENTITY),
        }
    }

    /// All maps in it, each after those before.
    fn as_transform(&self) -> Result<DAffine3> {
        let mut map = DAffine3::IDENTITY;
        for (_, step) in self.children()? {
            map = step.step()? * map;
        }
        match map.is_finite() && !is_singular(&map) {
            true => Ok(map),
            false => Err(self.error(format_args!("`{}` flattens space", self.name()))),
        }
    }

    /// One of the maps of a transform.
    fn step(&self) -> Result<DAffine3> {
        let node = self.node();
        match self.tag() {
            "translate" => Ok(DAffine3::from_translation(self.as_vector(0.0)?)),
            "scale" => Ok(DAffine3::from_scale(self.as_vector(1.0)?)),
            "rotate" => {
                let (axis, degrees) = self.rotation()?;
                Ok(DAffine3::from_mat3(rotation_as_mitsuba(axis, degrees)))
            }
            "lookat" | "lookAt" | "look_at" => self.look_at(),
            "matrix" => {
                let text = node.get("value").unwrap_or_default();
                let m = self.list("value", text)?;
                let rows = |n: usize| {
                    DMat3::from_cols_array(&[
                        m[0],
                        m[n],
                        m[2 * n],
                        m[1],
                        m[n + 1],
                        m[2 * n + 1],
                        m[2],
                        m[n + 2],
                        m[2 * n + 2],
                    ])
                };
                match m.len() {
                    9 => Ok(DAffine3::from_mat3(rows(3))),
                    16 if m[12..] == [0.0, 0.0, 0.0, 1.0] => Ok(DAffine3 {
                        matrix3: rows(4),
                        translation: DVec3::new(m[3], m[7], m[11]),
                    }),
                    16 => Err(self.error("<matrix>: expected 0 0 0 1 as the last row")),
                    n => Err(self.error(format_args!(
                        "<matrix>: expected 9 or 16 numbers, found {n}"
                    ))),
                }
            }
            other => {
                let known = ["translate", "rotate", "scale", "lookat", "matrix"];
                let error = self.error(format_args!("unknown <{other}> in a transform"));
                Err(match super::nearest(other, &known) {
                    Some(near) => error.hint(format!("did you mean <{near}>?")),
                    None => error.hint(format!("it may have {}", known.join(", "))),
                })
            }
        }
    }

    /// The axis of a `rotate` and its angle in degrees. Mitsuba 3 takes axes as they are, 0.6 at
    /// length 1, as is here one that was rounded.
    fn rotation(&self) -> Result<(DVec3, f64)> {
        let axis = self.as_vector(0.0)?;
        let unit = axis.try_normalize();
        let unit = unit.ok_or_else(|| self.error("<rotate>: the axis has no length"))?;
        let angle = self.node().get("angle");
        let angle = angle.ok_or_else(|| self.error("<rotate> has no `angle`"))?;
        let degrees = self.parse("angle", angle)?;
        let is_rounded = (axis.length() - 1.0).abs() <= UNIT_LENGTH_ERROR;
        let is_unit = is_rounded || self.tree.is_of_version_0() || degrees % 360.0 == 0.0;
        Ok((if is_unit { unit } else { axis }, degrees))
    }

    /// Whether it is a `rotate` that scales and shears, too.
    pub(super) fn is_distorting(&self) -> bool {
        let is_distorting = |(axis, _): (DVec3, f64)| !axis.is_normalized();
        self.tag() == "rotate" && self.rotation().is_ok_and(is_distorting)
    }

    /// A frame whose +z points from `origin` to `target`, with +x to the left of one who looks
    /// along.
    fn look_at(&self) -> Result<DAffine3> {
        let node = self.node();
        let need = |key: &str| {
            let text = node.get(key);
            let text = text.ok_or_else(|| self.error(format_args!("<lookat> has no `{key}`")))?;
            self.vector_in(text, false)
        };
        let (origin, target) = (need("origin")?, need("target")?);
        let ahead = (target - origin).try_normalize();
        let ahead = ahead.ok_or_else(|| self.error("<lookat>: `origin` is at `target`"))?;
        let up = match node.get("up") {
            Some(text) => self.vector_in(text, false)?,
            None => DVec3::ZERO,
        };
        let up = match up == DVec3::ZERO {
            true => ahead.any_orthonormal_vector(),
            false => up,
        };
        let left = up.cross(ahead).try_normalize();
        let left = left.ok_or_else(|| self.error("<lookat>: it looks along `up`"))?;
        Ok(DAffine3 {
            matrix3: DMat3::from_cols(left, ahead.cross(left), ahead),
            translation: origin,
        })
    }
}

/// The formula of Rodrigues, with axes of any length as Mitsuba 3 has it.
fn rotation_as_mitsuba(axis: DVec3, degrees: f64) -> DMat3 {
    if axis.is_normalized() {
        return DMat3::from_quat(about(axis, degrees));
    }
    let (sin, cos) = libm::sincos(degrees.to_radians());
    let (x, y, z) = (axis.x, axis.y, axis.z);
    let cross = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
    let along = DMat3::from_cols(axis * x, axis * y, axis * z);
    DMat3::IDENTITY * cos + along * (1.0 - cos) + cross * sin
}

/// Words between spaces and commas.
pub(super) fn words(text: &str) -> impl Iterator<Item = &str> {
    let is_between = |c: char| c.is_whitespace() || c == ',';
    text.split(is_between).filter(|word| !word.is_empty())
}
