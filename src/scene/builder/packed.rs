//! A packed scene as it is handed to a builder, for other cameras, another film or other lights.

use super::{LightInput, NO_CAMERA, NO_LIGHT, SceneBuilder};
use crate::Result;
use crate::scene::Scene;

/// A packed scene, whose surfaces and media stay as they are.
#[derive(Debug)]
pub(in crate::scene) struct PackedInput {
    pub(in crate::scene) scene: Scene,
    /// Whether its lights stay that are neither surfaces nor volumes.
    pub(in crate::scene) keeps_lights: bool,
    /// Whether its surfaces and volumes still send light.
    pub(in crate::scene) keeps_emission: bool,
}

impl PackedInput {
    /// Whether light comes from its surfaces or volumes.
    pub(in crate::scene) fn emits(&self) -> bool {
        self.scene.materials.iter().any(|m| m.emits()) || !self.scene.emissive.is_empty()
    }
}

impl SceneBuilder {
    /// The packed scene with what the builder has of cameras, film and lights in place of its own.
    pub(super) fn finish_packed(mut self, input: PackedInput) -> Result<Scene> {
        self.check_places()?;
        let emits = input.keeps_emission && input.emits();
        let mut scene = input.scene;
        scene.name = self.name.clone();
        scene.groups = std::mem::take(&mut self.groups);
        if let Some(film) = self.film {
            scene.film = film;
        }
        if !input.keeps_emission {
            for material in &mut scene.materials {
                (material.emission, material.emission_texture) = ([0.0; 3], None);
            }
            scene.emissive.clear();
        }
        let world_from_scene = scene.world_from_scene;
        if !input.keeps_lights {
            scene.warnings.retain(|w| w != NO_LIGHT);
            scene.environment_image = self.take_sky(&mut scene.notes)?;
            scene.is_environment_seen = !self.is_environment_unseen;
            let is_dark = self.lights.is_empty() && scene.environment_image.is_none() && !emits;
            if is_dark && !self.is_lit_in_part {
                self.lights.push(LightInput::environment([1.0; 3]));
                scene.warnings.push(NO_LIGHT.into());
            }
            let lights = self.lights.into_iter();
            scene.lights = lights.map(|l| l.in_scene(world_from_scene)).collect();
        }
        if !self.cameras.is_empty() {
            scene.warnings.retain(|w| w != NO_CAMERA);
            let cameras = self.cameras.into_iter();
            scene.cameras = cameras.map(|c| c.in_scene(world_from_scene)).collect();
            match self.frame.or(scene.files_of_frame) {
                Some(frame) => scene.go_to_frame(frame)?,
                None => scene.open_shutters()?,
            }
        }
        Ok(scene)
    }
}
