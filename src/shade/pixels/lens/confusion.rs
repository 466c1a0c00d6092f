//! How far a lens and an open shutter spread points over the film.

use crate::image::Region;
use crate::math::{Aabb, Ray};
use crate::scene::{Pose, Volume};
use crate::trace::Surface;
use crate::view::View;
use glam::Vec3;

/// How far the points of a view are spread over its film.
#[derive(Debug)]
pub struct Confusion<'a> {
    view: &'a View<'a>,
    /// The camera in the middle of the time that its shutter is open.
    middle: Pose,
    /// The camera over that time, once if it stands still.
    poses: Vec<Pose>,
    /// Distance of the background.
    far: f32,
    /// Boxes of the volumes, scene space.
    volumes: Vec<Aabb>,
    /// Pixels up to which light is looked up where a point is seen through the middle of the lens;
    /// what is spread farther is lit by itself.
    reach: u32,
}

impl<'a> Confusion<'a> {
    /// Of the width of a film, the reach at most: tiles look at as much around them.
    const MOST_REACH: f32 = 0.125;
    /// Times of a shutter that tell how far a point moves.
    const TIMES: usize = 5;
    /// Rays along each side of the film that tell how far anything is spread.
    const PILOT: u32 = 48;
    /// Distance of the background, in widths of the scene.
    const FAR: f32 = 1e3;

    /// Of a view whose camera is no pinhole.
    #[must_use]
    pub fn of(view: &'a View<'a>) -> Self {
        let middle = view.camera.pose();
        let poses = match view.camera.path.is_empty() {
            true => vec![middle],
            false => view.camera.path.clone(),
        };
        let size = view.tracer.scene.bounds();
        let mut confusion = Self {
            view,
            far: Self::FAR * (size.max - size.min).length(),
            middle,
            poses,
            volumes: view.tracer.scene.grids().map(Volume::bounds).collect(),
            reach: 0,
        };
        confusion.reach = confusion.pilot();
        confusion
    }

    /// See [`Self`]; the same for all parts of a film.
    #[must_use]
    pub fn reach(&self) -> u32 {
        self.reach
    }

    /// The camera at a time from 0 to 1 of its shutter.
    #[must_use]
    #[inline]
    pub fn pose(&self, time: f32) -> &Pose {
        &self.poses[(time * self.poses.len() as f32) as usize]
    }

    /// Whether the camera moves.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.poses.len() > 1
    }

    /// Where a point is seen through the middle of the lens, in the middle of the time.
    #[must_use]
    #[inline]
    pub fn on_film(&self, point: Vec3) -> Option<[f32; 2]> {
        Some(self.middle.on_film(&self.view.film, point)?.0)
    }

    /// Radius in pixels over which a point is spread at most; infinite for one behind the camera.
    #[must_use]
    pub fn radius(&self, point: Vec3) -> f32 {
        let film = &self.view.film;
        let Some((at, depth)) = self.middle.on_film(film, point) else {
            return f32::INFINITY;
        };
        let lens = self.middle.lens;
        let mut radius = lens.map_or(0.0, |l| l.confusion(depth) / self.view.pixel_angle);
        if self.moves() {
            let mut most = 0.0_f32;
            for i in 0..Self::TIMES {
                let pose = self.pose(i as f32 / Self::TIMES as f32 * 0.999 + 0.1);
                let Some(([x, y], _)) = pose.on_film(film, point) else {
                    return f32::INFINITY;
                };
                most = most.max((x - at[0]).abs()).max((y - at[1]).abs());
            }
            radius += 1.25 * most;
        }
        radius
    }

    /// Distances along a ray between which it would pass volumes, if it comes to any.
    #[must_use]
    pub fn span_of_media(&self, ray: &Ray) -> Option<[f32; 2]> {
        let mut span: Option<[f32; 2]> = None;
        for volume in &self.volumes {
            let Some(enter) = volume.enter(ray.origin, ray.direction) else {
                continue;
            };
            let leave = volume.leave(ray.at(enter), ray.direction) + enter;
            if enter < ray.t_max {
                let [first, last] = span.unwrap_or([enter, leave]);
                span = Some([first.min(enter), last.max(leave)]);
            }
        }
        span
    }

    /// Radii between which the media along such a part of a ray are spread: nothing where the
    /// camera moves.
    #[must_use]
    pub fn radii_in_media(&self, ray: &Ray, span: [f32; 2]) -> [f32; 2] {
        let ends = span.map(|t| ray.at(t.min(ray.t_max)));
        let radii = ends.map(|end| self.radius(end));
        let axis = self.view.camera.axis();
        let depths = ends.map(|end| (end - self.view.camera.origin()).dot(axis));
        let focus = self.middle.lens.map_or(0.0, |lens| lens.focus_distance);
        let is_sharp = self.moves() || (depths[0] <= focus && focus <= depths[1]);
        let least = if is_sharp {
            0.0
        } else {
            radii[0].min(radii[1])
        };
        [least, radii[0].max(radii[1])]
    }

    /// The same of the background in a direction.
    #[must_use]
    pub fn radius_of_background(&self, direction: Vec3) -> f32 {
        self.radius(self.background(direction))
    }

    /// The place of the background in a direction.
    fn background(&self, direction: Vec3) -> Vec3 {
        self.view.camera.origin() + direction * self.far
    }

    /// A part of the film with all around it that spreads into it, and `more` beside.
    #[must_use]
    pub fn around(&self, region: Region, more: u32) -> Region {
        let away = self.reach + more;
        let film = &self.view.film;
        Region {
            x0: region.x0.saturating_sub(away),
            y0: region.y0.saturating_sub(away),
            x1: (region.x1 + away).min(film.width),
            y1: (region.y1 + away).min(film.height),
        }
    }

    /// Pixels over which what few rays see is spread, and some more.
    fn pilot(&self) -> u32 {
        let View { tracer, film, .. } = self.view;
        let camera = self.view.camera;
        let (across, down) = (film.width.min(Self::PILOT), film.height.min(Self::PILOT));
        let mut most = 0.0_f32;
        for (j, i) in (0..down).flat_map(|j| (0..across).map(move |i| (j, i))) {
            let at = |k: u32, count: u32, size: u32| (k as f32 + 0.5) / count as f32 * size as f32;
            let (x, y) = (at(i, across, film.width), at(j, down, film.height));
            let direction = camera.direction(film, x, y);
            let hit = tracer.closest_seen(&Ray::endless(camera.origin(), direction));
            let radius = match hit {
                Some(hit) => self.radius(Surface::new(tracer.scene, hit.triangle, hit.uv).position),
                None => self.radius_of_background(direction),
            };
            most = most.max(radius);
        }
        let most = (1.25 * most + 2.0).min(f32::from(u16::MAX)).ceil() as u32;
        most.min(Self::most_reach(film.width))
    }

    /// The reach of films of a width, at most.
    #[must_use]
    pub fn most_reach(width: u32) -> u32 {
        (Self::MOST_REACH * width as f32).ceil() as u32 + 1
    }
}
