//! Light of environment images.

use super::*;

/// A sky that tells nothing of its light by symmetry, with one bright texel or more.
fn sky(texel: impl Fn(usize, usize) -> [f32; 3]) -> EnvironmentImage {
    let texels = (0..32).flat_map(|y| (0..64).map(move |x| (x, y)));
    let texels = texels.map(|(x, y)| texel(x, y)).collect();
    EnvironmentImage::new(64, 32, texels).unwrap()
}

/// A white floor below a sky, seen from above.
fn floor_below(image: EnvironmentImage) -> Scene {
    let mut scene = scene();
    let at = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    let corners = [at(-9.0, 9.0), at(9.0, 9.0), at(9.0, -9.0), at(-9.0, -9.0)];
    add_quad(&mut scene, corners, 1.0, 0.0, false);
    scene.environment_image = Some(image);
    scene
}

fn radiance_of_floor(scene: &Scene) -> f64 {
    radiance(scene, 2, Vec3::new(0.0, 1.0, 0.0), -Vec3::Y)
}

/// The image as bilinear between texels, summed finely over the upper hemisphere.
fn irradiance_over_pi(image: &EnvironmentImage) -> f64 {
    let (across, down) = (720, 180);
    let mut sum = 0.0;
    for y in 0..down {
        for x in 0..across {
            let place = [x, y].map(|c| c as f32 + 0.5);
            let d = image.direction([place[0] / across as f32, 0.5 * place[1] / down as f32]);
            let sin = f64::from(1.0 - d.y * d.y).sqrt();
            let share = sin * f64::from(d.y) * 2.0 * std::f64::consts::PI / f64::from(across);
            let share = share * 0.5 / f64::from(down);
            sum += f64::from(image.light(d).0[1]) * share;
        }
    }
    sum
}

#[test]
fn an_image_lights_a_floor_by_its_irradiance() {
    let even = sky(|_, _| [0.7; 3]);
    near(radiance_of_floor(&floor_below(even)), 0.7, 2e-3);
    // Bright where the lobe of the floor seldom looks, and black elsewhere.
    for bright in [[10, 14], [63, 0], [31, 8]] {
        let image = sky(|x, y| [if [x, y] == bright { 50.0 } else { 0.0 }; 3]).rotated(0.7);
        let expected = irradiance_over_pi(&image);
        near(radiance_of_floor(&floor_below(image)), expected, 0.02);
    }
    let steep = sky(|x, y| [(1.0 + (x as f32 * 0.2).cos()) * (1.0 + y as f32); 3]);
    let expected = irradiance_over_pi(&steep);
    near(
        radiance_of_floor(&floor_below(steep.clone())),
        expected,
        0.01,
    );
    // No turn about the normal changes that, and half of the radiance is half of the light.
    let turned = steep.clone().rotated(std::f32::consts::FRAC_PI_2);
    near(radiance_of_floor(&floor_below(turned)), expected, 0.01);
    let half = steep.scaled([0.5; 3]);
    near(radiance_of_floor(&floor_below(half)), 0.5 * expected, 0.01);
}

#[test]
fn cameras_see_the_image_and_white_media_do_not_show_before_an_even_one() {
    let image = sky(|x, y| [x as f32, y as f32 + 0.5, 1.0]);
    let mut scene = floor_below(image.clone());
    let up = Vec3::new(0.3, 0.8, -0.2).normalize();
    let seen = radiance(&scene, 0, Vec3::Y, up);
    assert_eq!(seen as f32, image.seen(up).0[1]);
    scene.mesh = Default::default();
    scene.environment_image = Some(sky(|_, _| [0.7; 3]));
    add_medium(&mut scene, DVec3::splat(-1.0), DVec3::ONE, 2.0, 1.0);
    near(
        radiance(&scene, 0, Vec3::new(0.1, 0.2, 4.0), -Vec3::Z),
        0.7,
        0.01,
    );
}

#[test]
fn a_sun_lights_the_same_in_its_image_and_taken_out() {
    let texels = (0..128 * 256).map(|i| {
        let is_sun = (40..42).contains(&(i % 256)) && (30..32).contains(&(i / 256));
        if is_sun { [2e4; 3] } else { [0.5; 3] }
    });
    let image = EnvironmentImage::new(256, 128, texels.collect()).unwrap();
    let lit = |input: EnvironmentInput| {
        let floor = [
            [-9.0, 0.0, 9.0],
            [9.0, 0.0, 9.0],
            [9.0, 0.0, -9.0],
            [-9.0, 0.0, -9.0],
        ];
        let floor = crate::scene::MeshInput::new("floor", floor, vec![[0, 1, 2], [0, 2, 3]]);
        let scene = crate::scene::SceneBuilder::new("floor").mesh(floor.albedo([1.0; 3]));
        let scene = scene.environment_image(input).build().unwrap();
        (radiance_of_floor(&scene), scene.lights.len())
    };
    let (taken, lights) = lit(EnvironmentInput::new(image.clone()));
    let (kept, none) = lit(EnvironmentInput::new(image).keeping_suns());
    assert_eq!((lights, none), (1, 0));
    near(taken, kept, 2e-3);
}
