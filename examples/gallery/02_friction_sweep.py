"""
Friction sweep
==============

How far does the part of the first push turn if the friction of the finger is not known well?
Ten thousand simulations take about a second.
"""

import matplotlib.pyplot as plt
import numpy as np

import fixel
from fixel.units import deg, mm

square = fixel.Polygon.rectangle(100 * mm, 100 * mm)
support = fixel.Tripod(radius=38 * mm, friction=0.25)
part = fixel.Body("part", square, mass=0.15, support=support)
drive = fixel.LineDrive(speed=20 * mm)
start = (-55 * mm, 20 * mm, 0)
finger = fixel.Pusher("finger", fixel.Disk(5 * mm), pose=start, drive=drive, friction=0.3)
scene = fixel.Scene(part, finger, duration=2.0)

friction = np.random.default_rng(1).uniform(0.1, 0.4, 10_000)
runs = fixel.simulate_batch(scene, {"mu_pusher": friction})
runs

# %%
turned = runs["part"].final.theta / deg
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3), sharey=True, layout="constrained")
left.scatter(friction, turned, s=1, rasterized=True)
left.set(xlabel="friction of the finger", ylabel="rotation [deg]")
right.hist(turned, bins=50, orientation="horizontal")
right.set(xlabel="simulations")
print(f"still touching: {runs.touching('part', 'finger').mean():.0%}")
