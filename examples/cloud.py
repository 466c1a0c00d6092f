# %% [markdown]
# # A cloud under a sky, from numbers
#
# `python examples/cloud.py cloud.png` makes a cloud of noise as a numpy array and renders it under a sun
# and a sky: the picture in the README.

# %%
import sys

import lvox
import numpy as np

N = 144
rng = np.random.default_rng(5)


def noise(cells: int) -> np.ndarray:
    """Smooth noise in a cube of N voxels, with so many cells along each axis."""
    lattice = rng.random((cells + 1,) * 3)
    at = (np.arange(N) + 0.5) / N * cells
    low = np.minimum(at.astype(int), cells - 1)
    share = at - low
    share = share * share * (3 - 2 * share)
    for axis in range(3):
        one, two = lattice.take(low, axis), lattice.take(low + 1, axis)
        shape = [-1 if i == axis else 1 for i in range(3)]
        lattice = one + (two - one) * share.reshape(shape)
    return lattice


# %% [markdown]
# Heaps of spheres give the shape, noise of ever smaller cells frays their edges.

# %%
x, y, z = np.meshgrid(*[np.linspace(-1, 1, N)] * 3, indexing="ij")
heap = np.full((N,) * 3, -9.0)
for _ in range(60):
    px, pz = rng.normal(0, [0.36, 0.24])
    room = max(0.0, 1 - np.hypot(px / 0.85, pz / 0.7))
    radius = 0.1 + 0.24 * room * rng.random()
    py = -0.45 + 0.8 * room * rng.random()
    distance = np.sqrt((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2)
    heap = np.maximum(heap, radius - distance)
fray = sum(noise(5 * 2**i) * 0.6**i for i in range(5)) - 1.15
density = np.clip((heap + 0.22 * fray) * 22, 0, 1) * np.clip((y + 0.52 + 0.12 * fray) * 5, 0, 1)

# %%
scene = {
    "film": {"width": 720, "height": 400, "exposure": 0.46},
    "camera": {"position": [0.2, -0.35, 4.4], "target": [-0.12, 0.2, 0], "fov_x_deg": 34},
    "volume": {
        "density": density,
        "unitcube_to_world": [[2.6, 0, 0, -1.3], [0, 2, 0, -0.8], [0, 0, 2, -1], [0, 0, 0, 1]],
        "sigma_t_scale": 70,
        "albedo": [0.998, 0.998, 0.998],
        "g": 0.6,
    },
    "light": [
        {"type": "environment", "radiance": [0.16, 0.33, 0.72]},
        {"type": "directional", "direction": [0.8, -0.62, -0.45], "irradiance": [9, 7.8, 6.2], "angular_radius_deg": 0.3},
    ],
}
output = sys.argv[1] if len(sys.argv) > 1 else "cloud.png"
with lvox.scene_file(scene) as words:
    print(lvox.run("render", *words, output=output))
