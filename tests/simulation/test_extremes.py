"""Many bodies and extreme speeds: tables of pairs, and what no number can relate."""

import copy
import warnings

import numpy as np
import pytest

from fixel import InvalidInput, simulate
from fixel.formats.scene_file import scene_file_from_dict
from fixel.model import Body, Disk, Fixel, LineDrive, PairFriction, Pusher, Scene, Tripod
from fixel.simulation.pack import pair_tables
from fixel.web.views import scene_editor

NAMES = ("a", "b", "c1", "c2", "d", "*", "c*", "?", "[ab]", "c[12]")


def scene_of(n_free, n_fixel, entries=()):
    """Bodies in a row, a pusher, and fixels in another."""
    disk = Disk(radius=0.01)
    return Scene(
        bodies=[
            Body(
                name=("a", "b", "c1", "c2", "d", "e")[k] if k < 6 else f"x{k}", shape=disk,
                mass=0.1, support=Tripod(radius=0.005, friction=0.3), pose=(0.03 * k, 0.0, 0.0),
            )
            for k in range(n_free)
        ],
        pushers=[
            Pusher(
                name="p", shape=disk, pose=(0.0, -0.1, 0.0), friction=0.11,
                drive=LineDrive(direction=(1.0, 0.0), speed=0.01, travel=0.1),
            )
        ],
        fixels=[
            Fixel(
                name=f"c{k + 8}", shape=disk, pose=(0.03 * k, 0.1, 0.0), friction=0.01 * k,
                restitution=0.001 * k,
            )
            for k in range(n_fixel)
        ],
        contact_friction=entries,
        duration=0.1,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(40))
def test_tables_of_pairs_are_what_the_scene_says_of_each(seed):
    rng = np.random.default_rng(seed)
    entries = [PairFriction(pair=("*", "*"), friction=0.5)]
    for k in range(rng.integers(8)):
        one, other = rng.choice(NAMES, 2)
        if one == other and one in NAMES[:5]:
            continue
        given = None if rng.random() < 0.5 else round(float(rng.random()), 3)
        entries.append(PairFriction(pair=(one, other), friction=0.6 + k, restitution=given))
    scene = scene_of(6, 3, [entries[k] for k in rng.permutation(len(entries))])
    friction, restitution = pair_tables(scene)
    for i, a in enumerate(scene.names):
        for j, b in enumerate(scene.names):
            pair = i != j and min(i, j) < 6
            assert friction[i, j] == (scene.friction(a, b) if pair else 0.0)
            assert restitution[i, j] == (scene.restitution(a, b) if pair else 0.0)


def test_no_pair_of_many_bodies_is_asked_for_alone(monkeypatch):
    scene = scene_of(40, 40, [PairFriction(pair=("*", "*"), friction=0.5)])
    asked = []
    for name in ("friction", "restitution", "_entry", "_obstacle"):
        monkeypatch.setattr(Scene, name, lambda *_, name=name: asked.append(name))
    pair_tables(scene)
    assert len(asked) < 80  # there are 2380 pairs


SPEEDS = (5e-324, 1e-308, 1e-200, 1e-160, 1e-50, 1e20, 1e60, 1e100, 1e160, 1e200, 1e308)


def refused_or_finite(content):
    """What becomes of a scene: a sentence, or numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            record = simulate(scene_file_from_dict(content).scene)
        except InvalidInput as refused:
            return str(refused)
    assert np.isfinite(record[content["bodies"][0]["name"]].pose).all()
    return record.status


@pytest.mark.parametrize("speed", SPEEDS)
def test_speeds_that_no_pusher_has(speed):
    content = copy.deepcopy(scene_editor.example("grasp"))
    content["pushers"][0]["drive"]["speed"] = speed
    found = refused_or_finite(content)
    assert ("fastest motion" in found) == (speed >= 1e100) or 1e20 < speed < 1e100
    if speed < 1.0:
        assert found == "converged"


@pytest.mark.parametrize("key", ["mass", "velocity", "gravity"])
@pytest.mark.parametrize("value", [1e-308, 1e-200, 1e200, 1e308])
def test_other_numbers_that_no_body_has(key, value):
    content = copy.deepcopy(scene_editor.example("grasp"))
    if key == "gravity":
        content["gravity"] = value
    else:
        content["bodies"][0][key] = value if key == "mass" else [value, 0.0, 0.0]
    assert refused_or_finite(content)
