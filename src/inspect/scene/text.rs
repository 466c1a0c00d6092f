//! The same as text.

use super::super::text::{Table, bytes, count};
use super::description::{
    MaskDescription, SceneDescription, Suggestion, ValueHistogram, VolumeDescription, WorldBox,
};
use crate::run::one_line;
use std::fmt;

/// A few digits of numbers, with spaces between.
fn brief<T: fmt::LowerExp + fmt::Display + Copy + Into<f64>>(numbers: &[T]) -> String {
    let number = |n: &T| {
        let value: f64 = (*n).into();
        match value.abs() {
            size if size != 0.0 && !(1e-3..1e7).contains(&size) => format!("{value:.4e}"),
            _ => {
                let text = format!("{value:.4}");
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            }
        }
    };
    numbers.iter().map(number).collect::<Vec<_>>().join(" ")
}

impl ValueHistogram {
    /// A bar for each bin, as high as the logarithm of its count.
    fn bars(&self) -> String {
        const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
        let most = self.counts.iter().copied().max().unwrap_or(0);
        let height = |n: u64| ((n as f64 + 1.0).ln() / (most as f64 + 1.0).ln() * 8.0).ceil();
        let bar = |n: &u64| BARS[(height(*n) as usize).min(8)];
        self.counts.iter().map(bar).collect()
    }
}

impl fmt::Display for WorldBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", brief(&self.min), brief(&self.max))
    }
}

impl fmt::Display for MaskDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", brief(&[self.opacity]))?;
        if let Some(texture) = self.texture {
            write!(f, " of texture {texture}")?;
        }
        match self.cutoff {
            Some(cutoff) => write!(f, ", cut off below {}", brief(&[cutoff])),
            None => Ok(()),
        }
    }
}

impl fmt::Display for SceneDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let memory = bytes(self.memory_bytes);
        writeln!(
            f,
            "{}: {}, {memory} in memory",
            one_line(&self.file),
            self.kind
        )?;
        writeln!(f, "scene '{}', {}", one_line(&self.name), self.scene_hash)?;
        if let Some(packed) = &self.packed {
            writeln!(f, "surfaces and volumes of {}", one_line(packed))?;
        }
        let m = &self.mesh;
        write!(
            f,
            "{} triangles, {} vertices",
            count(m.triangles),
            count(m.vertices)
        )?;
        if let Some(stored) = m.stored_triangles {
            let (stored, instances) = (count(stored), count(m.instances));
            write!(
                f,
                ", {stored} triangles are stored and placed {instances} times"
            )?;
        }
        if m.degenerate_triangles > 0 {
            let left_out = count(m.degenerate_triangles);
            write!(f, ", {left_out} triangles without area are left out")?;
        }
        writeln!(f, ", {}", bytes(m.memory_bytes))?;
        if let Some(bounds) = &m.bounds {
            writeln!(f, "area {}, bounds {bounds}", brief(&[m.area]))?;
        }
        if let Some([width, height]) = self.film {
            writeln!(f, "film {width} x {height}")?;
        }
        self.fmt_tables(f)?;
        self.volumes.iter().try_for_each(|v| v.fmt(f))?;
        self.warnings
            .iter()
            .try_for_each(|w| writeln!(f, "warning: {w}"))
    }
}

impl SceneDescription {
    fn fmt_tables(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut files = Table::new(&["file", "bytes"]);
        for file in &self.files {
            files.row(vec![file.path.clone(), count(file.bytes)]);
        }
        let mut columns = vec![
            "material",
            "triangles",
            "area",
            "albedo",
            "emission",
            "texture",
        ];
        let has_masks = self.materials.iter().any(|m| m.mask.is_some());
        columns.extend(has_masks.then_some("opacity"));
        let mut materials = Table::new(&columns);
        for m in &self.materials {
            let texture = m.texture.map_or("-".into(), |t| t.to_string());
            let mut row = vec![
                format!("'{}'{}", m.name, unseen(m.unseen)),
                count(m.triangles),
                brief(&[m.area]),
                brief(&m.albedo),
                match m.emission_texture {
                    Some(t) => format!("{} x texture {t}", brief(&m.emission)),
                    None => brief(&m.emission),
                },
                texture,
            ];
            row.extend(has_masks.then(|| m.mask.map_or("-".into(), |mask| mask.to_string())));
            materials.row(row);
        }
        let mut textures = Table::new(&["texture", "texels", "bits", "bytes"]);
        for (i, t) in self.textures.iter().enumerate() {
            let texels = format!("{} x {}", t.width, t.height);
            textures.row(vec![
                i.to_string(),
                texels,
                t.bits.to_string(),
                match t.shared_with {
                    Some(other) => format!("those of {other}"),
                    None => count(t.memory_bytes),
                },
            ]);
        }
        let mut lights = Table::new(&["light", "colour", "position", "direction"]);
        for l in &self.lights {
            let position = l.position.map_or("-".into(), |p| brief(&p));
            let direction = l.direction.map_or("-".into(), |d| brief(&d));
            let kind = format!("{}{}", l.kind, unseen(l.unseen));
            lights.row(vec![kind, brief(&l.color), position, direction]);
        }
        let mut cameras = Table::new(&["camera", "position", "direction", "degrees across"]);
        for c in &self.cameras {
            cameras.row(vec![
                format!("'{}'", c.name),
                brief(&c.position),
                brief(&c.direction),
                brief(&[c.fov_x_deg]),
            ]);
        }
        for table in [files, materials, textures, lights, cameras] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}

/// What follows the name of something that cameras do not see.
fn unseen(is_unseen: bool) -> &'static str {
    match is_unseen {
        true => " (unseen)",
        false => "",
    }
}

impl fmt::Display for VolumeDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grid = self
            .grid
            .as_ref()
            .map_or(String::new(), |g| format!(", grid '{}'", one_line(g)));
        let memory = bytes(self.memory_bytes);
        let (name, file) = (one_line(&self.name), one_line(&self.file));
        writeln!(f, "volume '{name}' of {file}{grid}, {memory}")?;
        let dims = self.dims.map(|n| n.to_string()).join(" x ");
        let share = 100.0 * self.active_voxels as f64 / self.voxels.max(1) as f64;
        let active = count(self.active_voxels);
        let first = self.first.map(|i| i.to_string()).join(" ");
        writeln!(
            f,
            "  voxels      {dims} from {first}, {active} active ({share:.1} %)"
        )?;
        writeln!(f, "  voxel edges {}", brief(&self.voxel_edges))?;
        if let Some(space) = self.patient_space {
            writeln!(
                f,
                "  patient     {space} in the file; unless the scene says otherwise left is x, \
                 superior y, anterior z"
            )?;
        }
        writeln!(f, "  bounds      {}", self.bounds)?;
        let (ends, mean) = (brief(&[self.min, self.max]), brief(&[self.active_mean]));
        let ends = ends.replace(' ', " to ");
        write!(f, "  values      {ends}, mean of the active {mean}")?;
        match self.negative_voxels {
            0 => writeln!(f)?,
            n => writeln!(f, ", {} below 0", count(n))?,
        }
        let h = &self.histogram;
        if !h.counts.is_empty() {
            let (from, to) = (brief(&[h.from]), brief(&[h.to]));
            writeln!(f, "  histogram   {from} |{}| {to}, logarithmic", h.bars())?;
        }
        let (most, mean) = (brief(&[self.sigma_t_max]), brief(&[self.sigma_t_mean]));
        let of_grid = if self.albedo_varies {
            "varies around "
        } else {
            ""
        };
        let albedo = format!("{of_grid}{}", brief(&self.albedo));
        write!(
            f,
            "  sigma_t     at most {most}, mean of the box {mean}, albedo {albedo}"
        )?;
        match &self.extinction_color {
            Some(color) => writeln!(f, ", extinction colour {}", brief(color))?,
            None => writeln!(f)?,
        }
        match self.phase_g[..] {
            [] => {}
            [g] => writeln!(f, "  phase       mean cosine {g}")?,
            _ => writeln!(
                f,
                "  phase       mean cosines {}, mix {}",
                brief(&self.phase_g),
                self.phase_mix
            )?,
        }
        let (most, mean) = (
            brief(&[self.voxel_depth_max]),
            brief(&[self.voxel_depth_mean]),
        );
        writeln!(f, "  voxel depth at most {most}, mean of the active {mean}")?;
        match &self.suggested {
            None => Ok(()),
            Some(Suggestion {
                window: [low, high],
                sigma_t_scale,
            }) => writeln!(
                f,
                "  try         window = [{low}, {high}], sigma_t_scale = {sigma_t_scale}"
            ),
        }
    }
}
