# %% [markdown]
# # Error against run time, from Python
#
# Renders the scene that is built in at three qualities, with one tree for all, and plots the error of each
# against a path-traced reference of the same scene: `python examples/error_over_time.py`. Cells begin at
# `# %%`, as notebooks and editors read them. Needs matplotlib.

# %%
import tempfile
import time
from pathlib import Path

import lvox
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZE = (160, 120)
folder = Path(tempfile.mkdtemp(prefix="error-over-time-"))

# %% [markdown]
# The truth, with direct light and one bounce, and its noise: a pixel's mean has a variance.

# %%
reference = lvox.reference("demo", resolution=SIZE, spp=256, max_depth=3)
print(f"variance of the reference {reference['variance'].mean():.1e}")

# %% [markdown]
# One bake, many frames.

# %%
tree = lvox.tree("demo", folder / "demo.lvt", bounces=1)
points = {}
for quality in ("draft", "good", "best"):
    start = time.perf_counter()
    image = lvox.render("demo", tree=tree, resolution=SIZE, quality=quality)
    secs = time.perf_counter() - start
    error = lvox.compare(image["beauty"], reference["beauty"])
    points[quality] = (secs, error["relmse_trimmed"])
    print(f"{quality:6} {secs:6.2f} s  trimmed relMSE {error['relmse_trimmed']:.2e}  bias {error['bias']:+.4f}")

# %%
figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
for quality, (secs, error) in points.items():
    axes.loglog(secs, error, "o")
    axes.annotate(quality, (secs, error), textcoords="offset points", xytext=(6, 6))
axes.set_xlabel("seconds, loading included")
axes.set_ylabel("trimmed relMSE")
figure.savefig(folder / "error-over-time.png", dpi=120)
print(folder / "error-over-time.png")
