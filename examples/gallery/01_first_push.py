"""
First push
==========

A pusher touches a square above its centre, so the square turns clockwise.
"""

import fixel

half = 0.05  # m
part = fixel.Body(
    name="part",
    shape=fixel.Polygon([(-half, -half), (half, -half), (half, half), (-half, half)]),
    mass=0.15,
    pose=(0, 0, 0),
    support=fixel.Tripod(radius=0.038, friction=0.25),
)
finger = fixel.Pusher(
    name="finger",
    shape=fixel.Disk(0.005),
    pose=(-0.055, 0.02, 0),
    drive=fixel.LineDrive(direction=(1, 0), speed=0.02),
    friction=0.3,
)
scene = fixel.Scene(bodies=[part], pushers=[finger], duration=2.0)
push = fixel.simulate(scene)
print(push.status, push.final["part"])
