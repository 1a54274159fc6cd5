"""
Orienting plan
==============

A wide fence pushes a part of unknown angle until it lies flat. Which rotations of the fence between
pushes leave one angle, whatever the first one was? The simulator then carries the plan out.
"""

import matplotlib.pyplot as plt
import numpy as np

import fixel
from fixel.drawing.palette import INK
from fixel.model import placed
from fixel.planning.geometric import flush_distance
from fixel.units import deg, mm

triangle = fixel.Polygon([(45 * mm, 45 * mm), (-80.9 * mm, 45 * mm), (45 * mm, -80.87 * mm)])
print(fixel.orienting_plan(triangle))

# %%
# One rotation of the shortest plan must be right within 4 degrees. With an error of 5 degrees a
# longer plan is safer.

plan = fixel.orienting_plan(triangle, angle_error=5 * deg)
plan

# %%
# Sixty simulated parts with random angles, supports and errors of the rotations up to 5 degrees.
# The length of each push is that which any support needs from 5 degrees off balance.

rng = np.random.default_rng(1)
n = 60
support = fixel.UniformPressure(friction=0.3)
part = fixel.Body("part", triangle, mass=0.8, pose=(1, 0, 0), support=support)
borders = plan.function.borders
travel = float(flush_distance(triangle, np.pi - borders - 5 * deg).max())
drive = fixel.LineDrive(speed=travel)
fence = fixel.Pusher(
    "fence", fixel.Polygon.rectangle(10 * mm, 4.0), pose=(-5 * mm, 0, 0), drive=drive, friction=0.2
)
scene = fixel.Scene(part, fence, duration=1.0)

angles = rng.uniform(0, 2 * np.pi, n)
stages = [angles]
for rotation in (*plan.rotations, None):
    corners = np.array([placed(triangle.outline, (0, 0, angle)) for angle in angles])
    start = np.column_stack((-corners[:, :, 0].min(axis=1), np.zeros(n), angles))
    spread = {"pressure_spread": rng.uniform(-1, 1, n)}
    angles = fixel.simulate_batch(scene, spread, start=start, motion="quasistatic").final[:, 0, 2]
    stages.append(angles)
    if rotation is not None:  # the direction of the next push, with its error
        angles = angles - rotation - rng.uniform(-5, 5, n) * deg

turned = np.mod(stages[-1] - plan.angle + np.pi, 2 * np.pi) - np.pi
print(f"{np.mean(np.abs(turned) < 0.1 * deg):.0%} of the parts end at the planned angle")

# %%
fig, axes = plt.subplots(1, len(stages), figsize=(8, 2), layout="constrained")
for k, (ax, angles) in enumerate(zip(axes, stages, strict=True)):
    for angle in angles:
        outline = placed(triangle.outline, (0, 0, angle))
        outline -= [outline[:, 0].min(), placed(triangle.centroid, (0, 0, angle))[1]]
        ax.fill(*outline.T / mm, facecolor="none", edgecolor=INK, alpha=0.2, linewidth=0.8)
    ax.axvline(0.0, color=INK, linewidth=2 if k else 0)
    ax.set(title=f"after push {k}" if k else "start", xlim=(-10, 180), ylim=(-130, 130))
    ax.set_aspect("equal")
    ax.set_axis_off()
