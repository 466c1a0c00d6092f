//! Files that other programs wrote.

use super::*;

/// A file of the shared data.
fn shared(name: &str) -> Option<Vec<u8>> {
    let path = skip::shared(&format!("data/{name}"))?;
    Some(std::fs::read(path).unwrap())
}

#[test]
fn real_smoke_is_read_to_the_last_voxel() {
    let Some(content) = shared("smoke.vdb") else {
        return;
    };
    let file = File::open(&content, &mut LeftOut::default()).unwrap();
    let grid = file
        .grid(&file.entries[0], None, &Cancel::default())
        .unwrap();
    assert_eq!(grid.tree.active(), 1_049_275);
    let (low, high) = grid.tree.extent().unwrap();
    assert_eq!((low, high), ([1, 2, 1], [111, 223, 112]));
    let field = grid
        .into_field(Arc::new(content.clone().into()), 0.0)
        .unwrap()
        .unwrap();
    assert_eq!(field.dims, [113, 224, 114]);
    let mut sum = 0.0;
    for k in 0..field.dims[2] {
        for j in 0..field.dims[1] {
            for i in 0..field.dims[0] {
                sum += f64::from(field.value([i, j, k]));
            }
        }
    }
    assert!((sum - 171_499.695_5).abs() < 1e-3, "{sum}");
    let p = (field.world_from_file.unwrap()).transform_point3(DVec3::ZERO);
    let expected = DVec3::new(-34.0476, -13.0952, -26.4286);
    assert!((p - expected).length() < 1e-3, "{p}");
}

#[test]
fn a_real_level_set_is_refused() {
    let Some(content) = shared("levelset_particles.vdb") else {
        return;
    };
    assert!(message(&content).contains("is a level set"));
}
