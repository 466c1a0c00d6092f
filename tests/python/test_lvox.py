"""The Python module, with the program that LVOX_PROGRAM names or that is installed with it."""

import os
import re
import tempfile
import unittest
import warnings
from pathlib import Path

import lvox
import numpy as np
from lvox._scene import to_toml

ROOM = {
    "film": {"width": 48, "height": 32},
    "camera": {"position": [0, 1, 4], "target": [0, 0.5, 0], "fov_x_deg": 40},
    "mesh": [
        {
            "vertices": np.array([[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]], np.float32),
            "triangles": np.array([[0, 2, 1], [0, 3, 2]]),
            "albedo": [0.7, 0.2, 0.1],
        },
        {"file": "builtin:cube", "translate": (0, 0.5, 0), "albedo": np.array([0.5, 0.5, 0.5])},
    ],
    "light": {"type": "directional", "direction": [0.5, -1, -0.3], "irradiance": [3, 3, 3]},
}
FAST = {"surfels": 3000, "quality": "draft"}


class Rendering(unittest.TestCase):
    def test_layers_are_arrays_that_add_up(self):
        image = lvox.render(ROOM, aov=["direct", "indirect", "depth", "normal"], **FAST)
        self.assertEqual(image["beauty"].shape, (32, 48, 3))
        self.assertEqual(image["beauty"].dtype, np.float32)
        self.assertEqual(image["depth"].shape, (32, 48))
        np.testing.assert_allclose(image["direct"] + image["indirect"], image["beauty"], rtol=1e-5, atol=1e-6)
        self.assertGreater(float(image["beauty"].mean()), 0.01)
        # Up is y: the floor before the cube looks there.
        self.assertGreater(image["normal"][30, 24, 1], 0.99)

    def test_a_volume_is_an_array_by_x_y_z(self):
        density = np.zeros((8, 6, 4), np.float32)
        density[6:, :, :] = 1
        smoke = {
            "density": density,
            "translate": [-1, 0, 1],
            "scale": [2, 2, 0.5],
            "sigma_t_scale": 40,
            "albedo": [0.1, 0.1, 0.1],
        }
        plain = lvox.render({**ROOM, "light": [ROOM["light"]]}, **FAST)["beauty"]
        dark = lvox.render({**ROOM, "volume": smoke}, **FAST)["beauty"]
        changed = np.abs(dark - plain).sum(axis=2) > 0.05
        # Only its right quarter is filled, which is right of the middle.
        self.assertGreater(changed[8:24, 30:44].mean(), 2 * changed[8:24, 4:18].mean())

    def test_a_mesh_far_from_the_origin_is_as_sharp(self):
        away = np.array([500000.0, 4649776.0, 100.0])
        corners = np.array([[-0.37, 0.013, -0.41], [0.43, 0.017, -0.39], [0.41, 0.31, 0.37], [-0.39, 0.29, 0.43]])

        def seen(place):
            mesh = {"vertices": corners + place, "triangles": np.array([[0, 2, 1], [0, 3, 2]])}
            camera = {"position": list(place + [0.3, 1.2, 2]), "target": list(place + [0, 0.1, 0]), "fov_x_deg": 25}
            return lvox.render({**ROOM, "camera": camera, "mesh": mesh}, **FAST)["beauty"]

        near = seen(np.zeros(3))
        self.assertGreater(float(near.mean()), 0.02)
        self.assertLess(lvox.compare(seen(away), near)["relmse"], 0.003)

    def test_an_array_is_the_sky(self):
        image = np.full((8, 16, 3), (0.1, 0.5, 0.2), np.float32)
        sky = {"type": "environment", "image": image}
        found = lvox.render({**ROOM, "light": sky}, **FAST)["beauty"]
        np.testing.assert_allclose(found[0, 0], (0.1, 0.5, 0.2), rtol=1e-4)
        with self.assertRaisesRegex(ValueError, "image of a light: expected height x width x 3"):
            lvox.render({"light": {"type": "environment", "image": image[0]}})

    def test_one_tree_serves_frames_and_gathers(self):
        with tempfile.TemporaryDirectory() as folder:
            tree = lvox.tree(ROOM, Path(folder) / "room.lvt", bounces=1, surfels=3000)
            frame = lvox.render(ROOM, tree=tree, quality="draft")["beauty"]
            whole = lvox.render(ROOM, bounces=1, **FAST)["beauty"]
            np.testing.assert_array_equal(frame, whole)
            points, up = [[1.2, 0.0, 0.4], [0.0, 3.0, 0.0]], [[0, 1, 0], [0, -1, 0]]
            light = lvox.gather(tree, points, up, occlusion=True)
            self.assertEqual(light["irradiance"].shape, (2, 3))
            # Red from the floor, looked at from above.
            red, _, blue = light["irradiance"][1]
            self.assertGreater(red, 1.5 * blue)
            self.assertGreater(light["occlusion"][1], 0.5)
            self.assertIn("mean_radiance", lvox.gather(tree, points))
            with self.assertRaisesRegex(lvox.InputError, "room.lvt"):
                lvox.tree(ROOM, tree, bounces=1, surfels=3000)

    def test_what_is_refused_says_so(self):
        with self.assertRaisesRegex(lvox.InputError, "albedoo"):
            lvox.render({"mesh": {"file": "builtin:cube", "albedoo": [1, 1, 1]}})
        with self.assertRaisesRegex(lvox.InputError, "none.toml") as refused:
            lvox.render("none.toml")
        self.assertEqual(refused.exception.code, 2)
        with self.assertRaises(lvox.InputError):
            lvox.render("demo", qualitty="draft")
        for wrong in ({"density": np.zeros((2, 2))}, {"density": np.zeros((0, 1, 1))}):
            with self.assertRaisesRegex(ValueError, "density"):
                lvox.render({"volume": wrong})
        with self.assertRaisesRegex(ValueError, "from 0 to 2"):
            lvox.render({"mesh": {"vertices": np.zeros((3, 3)), "triangles": np.array([[0, 1, 3]])}})

    def test_warnings_are_python_s(self):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            lvox.render({"mesh": {"file": "builtin:cube"}, "film": {"width": 8, "height": 8}}, **FAST)
        self.assertTrue(any(issubclass(w.category, lvox.LvoxWarning) for w in told), told)


class Comparing(unittest.TestCase):
    def test_arrays_and_files(self):
        reference = np.full((20, 30, 3), 0.5, np.float32)
        image = reference * np.float32(1.1)
        found = lvox.compare(image, reference)
        self.assertAlmostEqual(found["relmse"], 0.05**2 / (0.25 + 0.01), places=6)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.exr"
            lvox.write_exr(path, image)
            np.testing.assert_array_equal(lvox.read_exr(path)["beauty"], image)
            self.assertEqual(lvox.compare(path, image)["relmse"], 0)
        with self.assertRaisesRegex(ValueError, "height x width x 3"):
            lvox.compare(np.zeros((4, 4)), reference)

    def test_files_that_are_no_images_are_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.exr"
            lvox.write_exr(path, np.zeros((9, 7, 3)))
            whole = path.read_bytes()
            for size in (0, 3, 40, 200, len(whole) - 1):
                path.write_bytes(whole[:size])
                with self.assertRaises(ValueError):
                    lvox.read_exr(path)

    def test_halves_are_read_as_they_were_written(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.exr"
            lvox.run("render", "--demo", output=path, resolution=(37, 21), **FAST)
            half = lvox.read_exr(path)["beauty"]
            whole = lvox.render("demo", resolution=(37, 21), **FAST)["beauty"]
            self.assertEqual(half.shape, (21, 37, 3))
            np.testing.assert_allclose(half, whole, rtol=1e-3, atol=1e-6)


class Documents(unittest.TestCase):
    def test_the_page_runs_as_written(self):
        page = Path(__file__).parents[2] / "docs" / "python.md"
        (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
        home = os.getcwd()
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            try:
                names = {}
                exec(compile(code, str(page), "exec"), names)
            finally:
                os.chdir(home)
        self.assertEqual(names["image"]["depth"].shape, (240, 320))
        self.assertGreater(float(names["light"]["irradiance"].min()), 0)


class Scenes(unittest.TestCase):
    def test_values_are_those_of_toml(self):
        text = to_toml(
            {"name": 'a "b"\n\x7f', "film": {"width": np.int64(3), "exposure": 1e-9}, "light": [{"on": True, "x y": ()}]},
            Path("."),
        )
        self.assertEqual(
            text,
            'name = "a \\"b\\"\\n\\u007f"\n\n[film]\nwidth = 3\nexposure = 1e-09\n\n[[light]]\non = true\n"x y" = []\n',
        )
        for wrong in (float("nan"), object()):
            with self.assertRaises((TypeError, ValueError)):
                to_toml({"film": {"exposure": wrong}}, Path("."))

    def test_names_of_files_are_those_of_the_working_directory(self):
        here = Path.cwd()
        text = to_toml(
            {
                "mesh": [
                    {"file": "builtin:cube", "opacity": "mask.png", "emission_texture": Path("tex.png")},
                    {"file": "a.ply", "texture": "tex.png", "opacity": 0.5},
                ],
                "volume": {"file": "smoke.raw", "emission": {"file": "fire.raw", "scale": 2}},
            },
            Path("elsewhere"),
        )
        self.assertIn(f'packed = "{here / "a.lvp"}"\n', to_toml({"packed": "a.lvp"}, Path("elsewhere")))
        for name in ("mask.png", "tex.png", "a.ply", "smoke.raw", "fire.raw"):
            self.assertIn(f'"{here / name}"', text)
        self.assertIn("opacity = 0.5\n", text)
        self.assertIn('"builtin:cube"', text)
        with self.assertRaisesRegex(TypeError, "^texture of a mesh: expected the name of a file, found an array$"):
            to_toml({"mesh": {"file": "a.obj", "texture": np.zeros((4, 4, 3))}}, Path("."))


if __name__ == "__main__":
    unittest.main()
