"""
First push
==========

A finger touches a square above its centre. The square moves and turns clockwise.
"""

import fixel
from fixel.units import deg, mm

part = fixel.Body(
    "part",
    fixel.Polygon.rectangle(100 * mm, 100 * mm),
    mass=0.15,
    support=fixel.Tripod(radius=38 * mm, friction=0.25),
)
finger = fixel.Pusher(
    "finger",
    fixel.Disk(5 * mm),
    pose=(-55 * mm, 20 * mm, 0),
    friction=0.3,
    drive=fixel.LineDrive(speed=20 * mm),
)
scene = fixel.Scene(part, finger, duration=2.0)

# %%
# A simulation prints what is most important about it.
push = fixel.simulate(scene)
push

# %%
# It unpacks into numbers, and draws itself.
x, y, theta = push.final["part"]
print(f"moved {x / mm:.1f} mm, turned {theta / deg:.1f} degrees")
push.plot()
