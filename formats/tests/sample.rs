//! The size of a cloud by samples, beside that of the file.

use lvox_formats::record::{Lvoxel, Surfel, VolumeInfo};
use lvox_formats::{CHUNK_RECORDS, CloudMeta, CloudSample, CloudWriter, Overwrite};

/// Numbers between 0 and 1 that look random.
fn unit(i: usize, k: u64) -> f32 {
    let bits = xxhash_rust::xxh3::xxh3_64(&(i as u64 ^ k << 32).to_le_bytes());
    (bits >> 40) as f32 / (1 << 24) as f32
}

fn surfel(i: usize) -> Surfel {
    let [x, y] = [unit(i, 0), unit(i, 1)];
    // Walls of a room, one after the other; the light of each falls off.
    let wall = i / 7000 % 5;
    Surfel {
        position: [
            [x, y, 0.0],
            [x, 0.0, y],
            [1.0, x, y],
            [0.5, x, y],
            [x, x, y],
        ][wall],
        normal: [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]][wall % 2],
        radius: 0.01,
        area: 1e-4,
        front: [0.5 + x, (0.3 + x * y) * (wall as f32), 0.1],
        ..Surfel::default()
    }
}

fn lvoxel(i: usize) -> Lvoxel {
    let block = [i % 64, i / 64 % 64, i / 4096].map(|c| c as u16);
    let sigma_t = 1.0 + unit(i / 8, 2);
    Lvoxel {
        block,
        sigma_t,
        source: [unit(i, 3) * sigma_t, 1.0, 0.5],
        ..Lvoxel::default()
    }
}

#[test]
fn samples_tell_the_size_of_files() {
    let volume = VolumeInfo {
        name: "smoke".into(),
        dims: [64; 3],
        index_from_scene: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]],
        albedo: [0.9; 3],
        extinction_color: [1.0; 3],
    };
    let meta = CloudMeta {
        volumes: vec![volume],
        disk_overlap: 1.8,
        ..CloudMeta::default()
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    for (surfels, lvoxels) in [(200_000, 90_000), (50_000, 0), (0, 3000), (300, 0)] {
        let all: Vec<Surfel> = (0..surfels).map(surfel).collect();
        let media: Vec<Lvoxel> = (0..lvoxels).map(lvoxel).collect();
        let mut writer = CloudWriter::create(&path, meta.clone(), Overwrite::Replace).unwrap();
        writer.push_surfels(&all).unwrap();
        writer.push_lvoxels(&media).unwrap();
        writer.finish().unwrap();
        let written = std::fs::metadata(&path).unwrap().len() as f64;
        // An eighth in runs, or all of what is few.
        let every = if surfels + lvoxels > 20_000 { 8 } else { 1 };
        let mut sizes = CloudSample::new(&meta).unwrap();
        for chunk in all.chunks(CHUNK_RECORDS) {
            let runs = chunk.chunks(512).step_by(every);
            let mut sample = runs.flatten().copied().collect::<Vec<_>>();
            sizes.add_surfels(&mut sample, chunk.len()).unwrap();
        }
        for chunk in media.chunks(CHUNK_RECORDS) {
            let runs = chunk.chunks(512).step_by(every);
            let sample = runs.flatten().copied().collect::<Vec<_>>();
            sizes.add_lvoxels(&sample, chunk.len()).unwrap();
        }
        let told = sizes.file_bytes(surfels as u64, lvoxels as u64) as f64;
        let ratio = told / written;
        assert!(
            (0.9..1.1).contains(&ratio),
            "{surfels} {lvoxels} {every}: {ratio}"
        );
    }
}
