"""The player of a notebook: it is complete, small, and shows what was simulated."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from tests.web.conftest import unpacked

from fixel.simulation import simulate
from fixel.testing.scenes import grasp, pushed_square


def shown(page: str) -> dict:
    return json.loads(re.findall(r"\.show\((.*)\);</script>", page)[0])


def test_player_has_the_poses_and_contacts_of_a_simulation():
    run = simulate(grasp("seated"), duration=2.0)
    content = shown(run.animate().page)
    (motion,) = content["motions"]

    assert [thing["name"] for thing in content["things"]] == list(run.names)
    np.testing.assert_array_equal(unpacked(motion["time_s"]), run.time)
    for name, poses in run.pose.items():
        np.testing.assert_allclose(unpacked(motion["pose"][name]), poses, atol=1e-12)
    assert len(unpacked(motion["contacts"]["sample"])) == len(run.contacts)


@pytest.mark.parametrize("interval", [1e-2, 1e-4])
def test_cell_is_small_and_ends_where_the_simulation_does(interval):
    run = simulate(pushed_square(1.0), output_interval=interval)
    player = run.animate()
    (motion,) = shown(player.page)["motions"]

    assert len(player._repr_html_()) < 200_000
    end = unpacked(motion["pose"]["part"])[-1]
    np.testing.assert_allclose(end, run.pose["part"][-1], atol=1e-12)


def test_page_loads_nothing():
    page = simulate(pushed_square(0.2)).animate().page

    assert re.findall(r"https?://[^\s\"']+", page) == ["http://www.w3.org/2000/svg"]
    assert not re.search(r"\bimport\b|\bexport\b|@import|url\(|\bsrc=|fetch\(", page)


def test_a_name_is_no_script():
    scene = pushed_square(0.2)
    body = replace(scene.bodies[0], name="</script><script>alert(1)</script>")
    page = simulate(replace(scene, bodies=(body,))).animate().page

    assert page.count("</script>") == 1
    assert shown(page)["object"] == body.name


def test_player_needs_no_server():
    code = "import sys, fixel.web.views.notebook_player; assert 'fastapi' not in sys.modules"

    subprocess.run([sys.executable, "-c", code], check=True)
