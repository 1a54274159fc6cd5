"""MuJoCo: soft contacts by Newton's method on a convex problem, three dimensions."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from benchmarks.peers.task import Task

name = "MuJoCo"
version = mujoco.__version__
variants: dict[str, dict[str, Any]] = {
    "as shipped": {"softness": 0.02, "stiffer_friction": 1.0},
    "stiffer": {"softness": 0.004, "stiffer_friction": 10.0},
}

FOOT = 0.002  # [m] radius of a foot
THICKNESS = 0.005  # [m], half
GRAVITY = 9.81  # [m/s^2]
HEAVY = 1e7  # [kg]: a head that nothing slows down


class World(NamedTuple):
    model: Any
    data: Any
    steps: int


def build(task: Task, step: float, softness: float, stiffer_friction: float) -> World:
    """Support friction: three balls on a floor, each pressed down by its own weight ``N / g``."""
    model = mujoco.MjModel.from_xml_string(_document(task, step, softness, stiffer_friction))
    data = mujoco.MjData(model)
    data.qpos[:3] = task.start
    data.qvel[-1] = task.speed
    return World(model, data, task.steps(step))


def run(world: World) -> tuple[float, float, float]:
    mujoco.mj_step(world.model, world.data, world.steps)
    x, y, angle = world.data.qpos[:3]
    return float(x), float(y), float(angle)


def _document(task: Task, step: float, softness: float, stiffer_friction: float) -> str:
    """The model as MJCF.

    The body moves on two slides and a hinge; its mass sits in the feet, its inertia in itself. Only
    the named pairs touch, each with its own coefficient.
    """
    half = np.ptp(task.vertices, axis=0) / 2
    head = np.ptp(task.head, axis=0) / 2
    moving = 1e-3  # [kg] of the body beside its feet; the engine wants some
    feet = "".join(
        f'<body pos="{x} {y} 0"><joint type="slide" axis="0 0 1"/>'
        f'<inertial pos="0 0 0" mass="{load / GRAVITY}" diaginertia="1e-9 1e-9 1e-9"/>'
        f'<geom name="foot{k}" type="sphere" size="{FOOT}"/></body>'
        for k, ((x, y), load) in enumerate(zip(task.feet, task.loads, strict=True))
    )
    own = task.inertia - sum(
        load / GRAVITY * float(foot @ foot)
        for foot, load in zip(task.feet, task.loads, strict=True)
    )
    inertia = max(own, 1e-9)
    pegs = "".join(
        f'<geom name="peg{k}" type="sphere" pos="{x} {y} {FOOT}" size="{task.peg_radius}"/>'
        for k, (x, y) in enumerate(task.pegs)
    )
    pairs = "".join(
        _pair("floor", f"foot{k}", task.mu_support, softness) for k in range(len(task.feet))
    )
    pairs += _pair("object", "head", task.mu_head, softness)
    pairs += "".join(
        _pair("object", f"peg{k}", task.mu_peg, softness) for k in range(len(task.pegs))
    )
    return f"""
<mujoco>
  <compiler angle="radian" boundmass="0" boundinertia="0"/>
  <option timestep="{step}" gravity="0 0 -{GRAVITY}" cone="elliptic" solver="Newton"
    iterations="100" tolerance="1e-10" impratio="{stiffer_friction}" integrator="Euler"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>{pegs}
    <body pos="0 0 {FOOT}">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
      <joint type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="{moving}" diaginertia="{inertia} {inertia} {inertia}"/>
      <geom name="object" type="box" size="{half[0]} {half[1]} {THICKNESS}"/>{feet}
    </body>
    <body pos="0 0 {FOOT}">
      <joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{HEAVY}" diaginertia="1 1 1"/>
      <geom name="head" type="box" size="{head[0]} {head[1]} {THICKNESS}"/>
    </body>
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>"""


def _pair(one: str, other: str, friction: float, softness: float) -> str:
    return (
        f'<pair geom1="{one}" geom2="{other}" friction="{friction} {friction} 0 0 0" condim="3" '
        f'solref="{softness} 1" solimp="0.9 0.95 0.001 0.5 2"/>'
    )
