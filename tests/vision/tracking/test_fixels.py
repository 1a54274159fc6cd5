"""Fixels, by the rims of their tops."""

from dataclasses import replace

import numpy as np
from tests.vision.rendered import SIZE, bare_scene, small_rig, still

from fixel.model import Disk, Fixel
from fixel.testing.scenes import FIXEL_RADIUS
from fixel.vision.frame import Frame
from fixel.vision.render.looks import looks_named
from fixel.vision.render.virtual_camera import Sensor
from fixel.vision.tracking.follow import FixelFinder

PLACES = ((0.08, 0.055), (0.085, -0.03), (0.215, 0.05), (0.15, 0.06))
AWAY = np.array([0.9, 0.9, 0.0])


def test_a_side_that_shows_pushes_no_middle():
    """A fixel that is seen aslant hides some of the rim of its own top."""
    rig, looks = small_rig(), looks_named("thesis")
    fixels = tuple(
        Fixel(name=f"fixel-{k}", shape=Disk(FIXEL_RADIUS), pose=(*place, 0.0), friction=0.2)
        for k, place in enumerate(PLACES)
    )
    scene = bare_scene()
    gone = (replace(scene.bodies[0], pose=AWAY),)
    light = still(rig, looks, AWAY, replace(scene, bodies=gone, fixels=fixels))
    sensor = Sensor(looks, SIZE, 1)
    finder = FixelFinder(rig, fixels)
    for k in range(3):
        finder.see(Frame(k / 2.0, sensor.exposed(light, np.ones(3), k)))
    found = {fixel.name: fixel for fixel in finder.found()}
    off = [np.hypot(*(found[f.name].place - f.pose[:2])) for f in fixels]
    assert max(off) < 0.08e-3
