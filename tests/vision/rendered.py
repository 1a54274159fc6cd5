"""A small bench for tests of rendered pictures: the thesis's resolution, a fifth of its field."""

from dataclasses import replace

import numpy as np

from fixel.formats.rig_file import rig_of
from fixel.testing.scenes import grasp
from fixel.vision.lens import Lens
from fixel.vision.render.bench import RenderedBench

SIZE = (420, 320)
AWAY = np.array([-0.5, -0.4, 0.0])  # out of view


def small_rig(name="thesis-tags", size=SIZE):
    """The middle of an example rig's picture, without tags on the plate."""
    rig = rig_of(name)
    lens = rig.camera.lens
    shift = (np.array(lens.image_size) - size) // 2
    near = Lens(
        image_size=size, focal=lens.focal, centre=lens.centre - shift, distortion=lens.distortion
    )
    return replace(rig, camera=replace(rig.camera, lens=near), plate=())


def bare_scene():
    """The thesis's square and head, without fixels."""
    return replace(grasp(), fixels=())


def still(rig, looks, pose, scene=None, **more):
    """(h, w, 3) light of one instant."""
    bench = RenderedBench(scene or bare_scene(), rig, looks, 1)
    return bench.light([{"object": np.asarray(pose), "actuator": AWAY, **more}])
