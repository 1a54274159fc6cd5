"""Goal files against the objects that they describe; errors name the key or the line."""

import math

import pytest
from tests.fixtures import refused

from fixel import FreePushes, RigPushes
from fixel.formats.goal_file import goal_file_from_dict, load_goal
from fixel.io.document import parse_yaml
from fixel.model import goals
from fixel.uncertainty.error_terms import ASME, RPI_CAMERA

FULL = """
fixel: 1
scene: scenes/rig.yaml
goal:
  any:                       # one of these counts
    - pose: {pose_mm_deg: [180, 0, 90], position_mm: 2, angle_deg: 2, symmetry: 4}
    - seated: {fixels: [fixel-1, fixel-2], only: true, stalled: true}
    - all:
        - inside: {region_mm: [[0, 0], [10, 0], [10, 5]], tolerance_mm: 0.1}
        - beyond: {line_mm: [[8, 0], [8, -1]], feature_mm: [1, 2]}
  never:
    - contact: {fixel: fixel-4}
    - exit: {region_mm: [[0, 0], [400, 0], [400, 300], [0, 300]]}
    - force_above: 30
choose:
  rig:
    y_mm: [-30, 30]
    theta_deg: [-45, 45]
    stroke_mm: [20, 150]
    fixels_mm: {fixel-1: [[-1, 1], [0, 2]]}
belief:
  calibration: 7
  start: {preset: rpi-camera}
  camera: {preset: asme}
  lost_views: 0.1
  rig: {path_mm: 0.2, heading_deg: 0.3, travel_mm: 0.2, fixels_mm: 0.05}
  run_to_run: none
  conditions: {shape: hex}
want: {success: 0.9}
"""
GOAL = goals.AllOf(
    goals.AnyOf(
        goals.PoseRegion((0.18, 0, math.pi / 2), position=2e-3, angle=math.radians(2), symmetry=4),
        goals.Seated("fixel-1", "fixel-2", only=True, stalled=True),
        goals.AllOf(
            goals.Inside([(0, 0), (0.01, 0), (0.01, 0.005)], tolerance=1e-4),
            goals.Beyond([(0.008, 0), (0.008, -0.001)], feature=(0.001, 0.002)),
        ),
    ),
    never=[
        goals.Contact("fixel-4"),
        goals.Exit([(0, 0), (0.4, 0), (0.4, 0.3), (0, 0.3)]),
        goals.ForceAbove(30.0),
    ],
)


def test_a_goal_file_describes_goal_choice_and_belief(tmp_path):
    (tmp_path / "goal.yaml").write_text(FULL)
    found = load_goal(tmp_path / "goal.yaml")

    assert found.goal == GOAL
    assert isinstance(found.choose, RigPushes)
    assert found.choose.y == (-0.03, 0.03)
    assert found.choose.theta == pytest.approx((-math.pi / 4, math.pi / 4))
    assert found.choose.stroke == (0.02, 0.15)
    assert dict(found.choose.fixels or {}) == {"fixel-1": ((-1e-3, 1e-3), (0.0, 2e-3))}
    assert found.belief.start == RPI_CAMERA
    assert found.views == {"camera": ASME, "lost_views": 0.1}
    assert found.belief.rig.fixels == 5e-5
    assert found.belief.conditions == {"shape": "hex"}
    assert (found.calibration, found.run_to_run) == (7, False)
    assert (found.success, found.confidence) == (0.9, 0.95)
    assert found.scene == tmp_path / "scenes" / "rig.yaml"


def seated(rest):
    """A file with a goal and other entries."""
    text = f"{{fixel: 1, goal: {{seated: {{fixels: [a]}}}}, {rest}}}"
    return goal_file_from_dict(parse_yaml(text, "text"))


@pytest.mark.parametrize("form", ["free", "rig"])
def test_obstacles_and_cost_of_pushes(form):
    text = "{cost: length, obstacles_mm: [[[0, 0], [10, 0], [10, 20]], [[5, 5], [6, 5], [6, 6]]]}"
    found = seated(f"choose: {{{form}: {text}}}")
    assert found.choose.cost == "length"
    assert [own.area for own in found.choose.obstacles] == pytest.approx([1e-4, 5e-7])


@pytest.mark.parametrize(("text", "where"), [
    ("{cost: lenght}", "choose.free.cost"),
    ("{obstacles_mm: [[[0, 0], [1, 0]]]}", r"choose.free.obstacles_mm\[0\]"),
    ("{obstacles_mm: [[[0, 0], [1, 0], [2, 0]]]}", r"choose.free.obstacles\[0\].*no area"),
])  # fmt: skip
def test_obstacles_and_costs_that_are_none(text, where):
    refused(seated, f"choose: {{free: {text}}}", match=where)


def test_free_pushes_and_intervals_of_parameters():
    found = goal_file_from_dict(
        parse_yaml(
            """
            fixel: 1
            goal: {seated: {fixels: [a]}}
            choose: {free: {most: 3, tool: {disk_mm: 5}, length_mm: [5, 60], retract_mm: 4}}
            belief:
              parameters: {mu_pusher: [0.2, 0.4], friction_centre_x_mm: [-2, 2], start_theta_deg: 3}
              start: {x_mm: 1, kind: uniform}
            """,
            "text",
        )
    )
    assert isinstance(found.choose, FreePushes)
    assert (found.choose.most, found.choose.length) == (3, (5e-3, 6e-2))
    assert found.choose.tool.radius == 5e-3
    assert (found.choose.retract, found.choose.angle) == (4e-3, pytest.approx(math.pi / 6))
    assert found.belief.parameters == {
        "mu_pusher": (0.2, 0.4),
        "friction_centre_x": (-2e-3, 2e-3),
        "start_theta": pytest.approx(math.radians(3)),
    }
    assert found.belief.start.kind == "uniform"


@pytest.mark.parametrize(("belief", "message"), [
    ("{parameters: {friction_centre_x: [-2, 2]}}", "fixel needs friction_centre_x_mm.*mm"),
    ("{parameters: {tripod_radius: 0.03}}", "fixel needs tripod_radius_mm"),
    ("{parameters: {start_theta: 0.1}}", "fixel needs start_theta_deg"),
    ("{parameters: {mu_pusher_mm: 0.1}}", "needs mu_pusher;"),
    ("{parameters: {friction_center_x_mm: 1}}", "did you mean 'friction_centre_x'"),
    ("{start: {x_mm: 1}}", r"belief\.start\.kind: found none.*half-widths"),
    ("{start: {preset: asme, kind: normal}}", "a preset and sizes"),
])  # fmt: skip
def test_units_and_kinds_are_named(belief, message):
    refused(seated, f"belief: {belief}", match=message)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("fixel: 1", "fixel: 2", r"goal\.yaml: fixel is 2"),
    ("position_mm", "positoin_mm", r"goal\.any\[0\]\.pose\.positoin_mm.*position_mm"),
    ("position_mm: 2", "position_mm: -2", r"goal\.any\[0\]\.pose\.position_mm.*greater than 0"),
    ("fixel: fixel-4", "fixels: fixel-4", r"goal\.never\[0\]\.contact"),
    ("[[8, 0], [8, -1]]", "[[8, 0], [8, 0]]", r"goal\.any\[2\]\.all\[1\]\.beyond\.line.*different"),
    ("[[0, 0], [10, 0], [10, 5]]", "[[0, 0], [10, 0], [20, 0]]", r"goal\.any\[2\].*no area"),
    ("force_above: 30", "forces_above: 30", "did you mean 'force_above'"),
    ("position_mm: 2, angle_deg: 2, ", "", r"goal\.any\[0\]\.pose.*found a pose without"),
    ("any:", "both:", r"goal\.both: found an unknown key"),
    ("stroke_mm: [20, 150]", "stroke_mm: [150, 20]", r"choose\.rig\.stroke"),
    ("stroke_mm: [20, 150]", "stroke_mm: [-20, 150]", r"choose\.rig\.stroke.*from 0"),
    ("preset: rpi-camera", "preset: rpi", r"belief\.start\.preset.*one of asme, rpi-camera"),
    ("{preset: rpi-camera}", "{preset: asme, x_mm: 1}", r"belief\.start.*a preset and sizes"),
    ("calibration: 7", "calibration: seven", r"belief\.calibration.*whole number"),
    ("calibration: 7", "calibration: 7\n  parameters: {mu_pusher: 1}", "one of them"),
    ("success: 0.9", "success: 90", r"want\.success.*at most 1"),
    ("goal:", "goals:", r"goal\.yaml: goal is missing: give a value"),
    ("  any:", "   any: {", "line"),
])  # fmt: skip
def test_errors_name_the_key_or_the_line(old, new, message, tmp_path):
    assert old in FULL
    (tmp_path / "goal.yaml").write_text(FULL.replace(old, new, 1))
    refused(load_goal, tmp_path / "goal.yaml", match=message)
