//! What the points of a scene are made with, ready before the first of them.

use super::cover::Cover;
use super::creases::Creases;
use super::lvoxels::LvoxelMaker;
use super::surfels::{AreaSampler, SurfelMaker, SurfelSource};
use super::{Settings, SurfelSampling, camera, count};
use crate::Result;
use crate::light::{KeptLight, Lights, SceneMedia, Shadows, SoftShadowMedia};
use crate::math::Spectrum;
use crate::run::{Job, Walked};
use crate::scene::{Scene, Volume};
use crate::trace::Tracer;
use std::sync::Arc;

/// A scene with its lights, its creases, and the light that is kept in its media.
pub struct Prepared<'a, K> {
    pub scene: &'a Scene,
    pub settings: &'a Settings,
    pub job: &'a Job,
    tracer: &'a Tracer<'a>,
    lights: &'a Lights<'a, SceneMedia<'a, K>>,
    creases: &'a Creases<'a>,
    kept: &'a KeptLight<'a>,
}

impl<'a, K: Spectrum> Prepared<'a, K> {
    /// Prepares a scene, and works with it. The work is told what rays passed for the light that is
    /// kept in media.
    ///
    /// # Errors
    /// A stop on request, or that of the work.
    pub fn with<T>(
        scene: &Scene,
        settings: &Settings,
        job: &Job,
        work: impl FnOnce(&Prepared<'_, K>, Walked) -> Result<T>,
    ) -> Result<T> {
        let tracer = Tracer::new_until(scene, &job.cancel)?;
        let shadows = SoftShadowMedia::new(scene, &scene.volumes)?;
        let lights = Lights::<SceneMedia<K>>::new(&tracer)
            .for_baking()
            .with_soft_shadows(shadows.as_ref());
        let creases = Creases::new(&scene.mesh, settings.crease_deg, &job.cancel)?;
        let before = Walked::so_far();
        let kept = KeptLight::new(&tracer, || job.cancel.check())?;
        let passed = Walked::so_far() - before;
        let prepared = Prepared {
            scene,
            settings,
            job,
            tracer: &tracer,
            lights: &lights,
            creases: &creases,
            kept: &kept,
        };
        work(&prepared, passed)
    }

    /// Works with the source of all surfels.
    ///
    /// # Errors
    /// A stop on request, an unknown camera, or that of the work.
    pub fn with_surfels<T>(&self, work: impl FnOnce(&SurfelSource) -> Result<T>) -> Result<T> {
        match self.scene.volumes.is_empty() {
            true => work(&self.surfels(&self.maker(&self.lights.in_vacuum()))?),
            false => work(&self.surfels(&self.maker(self.lights))?),
        }
    }

    fn maker<'m, S>(&'m self, lights: &'m Lights<'m, S>) -> SurfelMaker<'m, S> {
        SurfelMaker {
            tracer: self.tracer,
            lights,
            creases: self.creases,
            shadow_rays: self.settings.shadow_rays,
            seed: self.settings.seed,
        }
    }

    fn surfels<'m, S: Shadows>(&self, maker: &'m SurfelMaker<'m, S>) -> Result<SurfelSource<'m>> {
        let settings = self.settings;
        let by_area = |count: u64| {
            let sampler = AreaSampler::new(maker.tracer, count, settings.seed);
            SurfelSource::by_area(maker, sampler, settings.overlap)
        };
        match &settings.surfels {
            SurfelSampling::ByLight => Ok(by_area(count::surfels_for(maker, self.job)?)),
            SurfelSampling::Area { count } => Ok(by_area(*count)),
            SurfelSampling::Camera {
                name,
                rate,
                overscan,
            } => {
                let camera = self.scene.camera(name.as_deref())?;
                let frustum = camera::Frustum::new(self.scene, camera, *rate, *overscan);
                Ok(frustum.surfels(maker, settings.overlap))
            }
        }
    }

    /// Makers of lvoxels, one for each volume.
    pub fn lvoxel_makers(&self) -> impl Iterator<Item = LvoxelMaker<'a, K>> {
        let volumes = &self.scene.volumes;
        // Of the volume that the last one was made for.
        let mut last: Option<(usize, Arc<Cover>)> = None;
        volumes.iter().enumerate().map(move |(index, volume)| {
            last = last.take().filter(|(of, _)| volume.adds_to(&volumes[*of]));
            if last.is_none() && Cover::is_worth_it(volume) && !self.kept.knows_sky(self.lights) {
                let others = volumes.iter().enumerate();
                let others = others.filter(|(i, other)| *i != index && other.adds_to(volume));
                let others: Vec<&Volume> = others.map(|(_, other)| other).collect();
                last = Some((index, Arc::new(Cover::new(volume, &others))));
            }
            LvoxelMaker {
                volume,
                index: index as u16,
                lights: self.lights,
                kept: self.kept,
                cover: last.as_ref().map(|(_, cover)| Arc::clone(cover)),
                size: self.settings.blocks,
                shadow_rays: self.settings.shadow_rays,
                seed: self.settings.seed,
            }
        })
    }
}
