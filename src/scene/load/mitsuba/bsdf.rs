//! Materials of a Mitsuba file: what is diffuse in them.

use super::color::Paint;
use super::element::Element;
use super::{Reader, plugins};
use crate::Result;

/// What a surface looks like.
#[derive(Clone, Debug)]
pub(super) enum Surface {
    /// Diffuse on both sides.
    Diffuse(Paint),
    /// Light goes through it as if it were not there.
    None,
}

impl Reader<'_> {
    /// The surface of a shape; of one that says nothing, that which Mitsuba takes.
    pub(super) fn surface_of(&mut self, shape: &Element<'_>) -> Result<Surface> {
        match shape.object("bsdf")? {
            Some(bsdf) => self.surface(&bsdf),
            None => Ok(Surface::Diffuse(Paint::plain([0.5; 3]))),
        }
    }

    fn surface(&mut self, bsdf: &Element<'_>) -> Result<Surface> {
        self.enter(bsdf)?;
        let surface = self.surface_of_kind(bsdf);
        self.leave();
        surface
    }

    fn surface_of_kind(&mut self, bsdf: &Element<'_>) -> Result<Surface> {
        bsdf.take();
        let kind = bsdf.kind();
        let diffuse = |reader: &mut Self, key: &str, default: f32| {
            reader.paint(bsdf, key, default).map(Surface::Diffuse)
        };
        match kind {
            "diffuse" => {
                let key = ["reflectance", "diffuse_reflectance"];
                let key = match bsdf.get(key[0])? {
                    Some(_) => key[0],
                    None => key[1],
                };
                diffuse(self, key, 0.5)
            }
            "twosided" => {
                let inner = bsdf.objects()?;
                let [(_, first), rest @ ..] = &inner[..] else {
                    return Err(bsdf.error("there is no bsdf in it"));
                };
                if let Some((_, back)) = rest.first() {
                    back.take();
                    let what = "surfaces look on their back as on their front";
                    self.left_out.note(what, back.line());
                }
                self.surface(first)
            }
            "mask" => self.mask(bsdf),
            "null" => Ok(Surface::None),
            "bumpmap" | "normalmap" | "coating" | "roughcoating" => {
                self.simplified(bsdf, "bumps, normal maps and coats are left out");
                self.inner(bsdf)
            }
            "blendbsdf" | "mixturebsdf" => self.blend(bsdf),
            "plastic" | "roughplastic" | "pplastic" | "phong" | "ward" => {
                self.simplified(bsdf, "highlights are left out");
                diffuse(self, "diffuse_reflectance", 0.5)
            }
            "roughdiffuse" => {
                self.simplified(bsdf, "rough diffuse surfaces are taken as diffuse");
                diffuse(self, "reflectance", 0.5)
            }
            "principled" | "principledthin" => {
                self.simplified(
                    bsdf,
                    "principled surfaces are taken as diffuse of their base colour",
                );
                diffuse(self, "base_color", 0.5)
            }
            "conductor" | "roughconductor" => {
                self.simplified(
                    bsdf,
                    "metals are taken as diffuse of their reflectance, or of 1/2",
                );
                diffuse(self, "specular_reflectance", 0.5)
            }
            "dielectric" | "thindielectric" | "roughdielectric" => {
                self.simplified(bsdf, "surfaces of glass are left out");
                Ok(Surface::None)
            }
            _ => {
                if let Some(error) = plugins::unknown(bsdf) {
                    return Err(error);
                }
                let what = format!("surfaces of the type `{kind}` are taken as diffuse of 1/2");
                self.simplified(bsdf, &what);
                Ok(Surface::Diffuse(Paint::plain([0.5; 3])))
            }
        }
    }

    /// Tells what becomes of a material; its other parameters are told with that.
    fn simplified(&mut self, bsdf: &Element<'_>, what: &str) {
        self.left_out.note(what, bsdf.line());
        for &child in &bsdf.node().children {
            bsdf.tree.nodes[child].used.set(true);
        }
    }

    /// The first material in one.
    fn inner(&mut self, bsdf: &Element<'_>) -> Result<Surface> {
        match bsdf.object("bsdf")? {
            Some(inner) => self.surface(&inner),
            None => Err(bsdf.error("there is no bsdf in it")),
        }
    }

    fn mask(&mut self, bsdf: &Element<'_>) -> Result<Surface> {
        let opacity = self.paint(bsdf, "opacity", 0.5)?;
        if opacity.is_of_vertices {
            let what = "opacities of vertices are taken as 1";
            self.left_out.note(what, bsdf.line());
        }
        let inner = self.inner(bsdf)?;
        let Surface::Diffuse(mut paint) = inner else {
            return Ok(inner);
        };
        if opacity.mean() == [0.0; 3] {
            return Ok(Surface::None);
        }
        if paint.opacity.is_some() {
            let what = "of masks in masks the outer one is taken";
            self.left_out.note(what, bsdf.line());
        }
        paint.opacity = Some(Box::new(opacity));
        Ok(Surface::Diffuse(paint))
    }

    /// Two materials and the weight of the second.
    fn blend(&mut self, bsdf: &Element<'_>) -> Result<Surface> {
        let weight = self.paint(bsdf, "weight", 0.5)?;
        self.simplified(
            bsdf,
            "blended surfaces are taken as diffuse of their mean colour",
        );
        let share = weight.mean()[0];
        let mut parts = Vec::new();
        for (_, inner) in bsdf.objects()? {
            if inner.tag() == "bsdf" {
                parts.push(self.surface(&inner)?);
            }
        }
        let color = |surface: &Surface| match surface {
            Surface::Diffuse(paint) => paint.mean(),
            Surface::None => [0.0; 3],
        };
        match &parts[..] {
            [] => Err(bsdf.error("there is no bsdf in it")),
            [one] => Ok(one.clone()),
            [a, b, ..] => {
                let (a, b) = (color(a), color(b));
                let mean = std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
                Ok(Surface::Diffuse(Paint::plain(mean)))
            }
        }
    }
}
